"""Draw what is even with fewer, larger Gaussians, and take back what shows.

A wall of one colour needs no Gaussian a pixel. Where the Gaussians of 2x2 neighbouring pixels, and
of those around them, are alike and lie on one surface, one takes the place of the four, and one of
such four in turn. Then the given views are drawn, and where they changed too much the pixels get
their own Gaussians back. What is left of the change is measured by drawing once more.

Nothing is left out because the given views do not see it: another view may. Dropping what has
little light was tried, and costs more than it saves (`docs/measured/rasterizer.md`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.rasterize.picture import picture, seen_colors
from slgaussian.rasterize.render_settings import PRESETS
from slgaussian.scene import Camera

GREY = 1 / 255
"""A grey level."""

COLOUR, OPACITY, FEATURE = 16 * GREY, 0.1, 1 / 64
"""How far apart the least and the greatest may be, of all that are merged and of those around them:
of a colour, of opacities and of a semantic feature. Looser colours have more taken back: at 24 grey
levels up to 0.05 more of the Gaussians remain, at 12 up to 0.02."""

HALVINGS = 2
"""How often four become one. A third time leaves as many and costs a tenth of the error more."""

APART = 6.0
"""Standard deviations of the wider one between neighbours past which a surface ends."""

BENT = 2.0
"""How far four neighbours may be from a parallelogram, in its shorter side. Depth has that noise,
and along the line of sight it hardly shows."""

BLOCK = 4
"""Pixels along a side of the blocks in which changes are judged."""

LIMIT = 2 * GREY
"""Mean change of a block above which what is merged there is taken back."""

MOST = GREY
"""Greatest root of the mean square change of a given view."""

AIM = 0.9
"""What a view that is over :data:`MOST` is brought down to, as a share of it: where one block is
taken back its neighbours change too."""

ROUNDS = 2
"""How often what shows most is taken back, while a view is over :data:`MOST`; then it gets back all
that it sees."""

BEHIND = 0.1
"""How much farther than the surface that a view shows a thing must be, as a share of its depth, not
to show there. Of what many views see of a wide scene, most is behind something in most of them."""

REACH = 3.0
"""Standard deviations past which a Gaussian shows no more."""

LOW_PASS = PRESETS["fast"].low_pass

VISIBLE = 0.5
"""Least opacity at which a mean colour is shown in full, as fields are shown."""


@dataclass(frozen=True)
class Change:
    """What the given views lost by merging, in grey levels over all channels of all pixels.

    Attributes
    ----------
    mean : float
        Mean absolute change.
    rms : float
        Root of the mean square change, of the view where it is greatest.
    greatest : float
        Of any channel of any pixel.
    """

    mean: float = 0.0
    rms: float = 0.0
    greatest: float = 0.0


@dataclass(frozen=True, eq=False)
class Merged:
    """What is left, and what that changed.

    Attributes
    ----------
    gaussians : Gaussians
        In the order of those given; ``source`` of a merged one is the first of its pixels.
    into : int64 [N]
        For each that was given, which of these stands for it.
    change : Change
    """

    gaussians: Gaussians
    into: np.ndarray
    change: Change


def merge(gaussians: Gaussians, cameras: Sequence[Camera]) -> Merged:
    """Merge Gaussians of neighbouring pixels while the given views stay as they are.

    No view changes by more than a grey level (:data:`MOST`); see :class:`Change`. Where one would,
    its blocks that change most get their own Gaussians back, and other views keep what is merged.

    Parameters
    ----------
    gaussians : Gaussians
        ``source`` tells their pixels; the first of a pixel may be merged, others stay. Of one with
        semantic features, those are alike that have the same object.
    cameras : sequence of V Camera
        The context views, in their order, all of one size.

    Raises
    ------
    InputError
        If there is no camera, they differ in size, or a source is outside of them.
    """
    grid = _Grid.of(gaussians, cameras)
    sizes = grid.sizes()
    given = [_picture(gaussians, camera) for camera in cameras]
    before, depths = [picture for picture, _ in given], [_farthest(depth) for _, depth in given]
    merged, into = _joined(gaussians, grid, sizes)
    changes = _changes(merged, cameras, before)
    for attempt in range(ROUNDS + 1):
        over = [_showing(change) for change in changes]
        if attempt == ROUNDS:
            # What a view shows through its surfaces, too, where that is still too much.
            for v in (v for v, one in enumerate(changes) if _summary([one]).rms > MOST / GREY):
                over[v], depths[v] = np.ones_like(over[v]), np.full_like(depths[v], np.inf)
        _take_back(sizes, grid, over, cameras, depths)
        merged, into = _joined(gaussians, grid, sizes)
        changes = _changes(merged, cameras, before)
        change = _summary(changes)
        if change.rms <= MOST / GREY:
            return Merged(merged, into, change)
    return Merged(gaussians, np.arange(len(gaussians)), Change())


def _picture(gaussians: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Colours float32 [H, W, 3] as a field shows them, and depth float32 [H, W]."""
    drawn = picture(gaussians, seen_colors(gaussians, camera), camera)
    shown = drawn.values / np.maximum(drawn.alpha, np.float32(VISIBLE))[..., None]
    return shown.clip(0, 1), drawn.depth


def _changes(
    gaussians: Gaussians, cameras: Sequence[Camera], before: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """How each view differs from what it was: float32 [H, W, 3], at least 0."""
    return [
        np.abs(_picture(gaussians, camera)[0] - was)
        for camera, was in zip(cameras, before, strict=True)
    ]


def _showing(change: np.ndarray) -> np.ndarray:
    """Blocks bool [h, w] whose change is too much: by itself, or for the sum of their view."""
    means = _block_means(change.mean(2))
    squares = _block_means(np.square(change).mean(2))
    least_first = np.sort(squares, axis=None)
    sums = np.cumsum(least_first, dtype=np.float64)
    if sums[-1] <= squares.size * MOST**2:
        return _near(means > LIMIT)
    within = int(np.searchsorted(sums, squares.size * (AIM * MOST) ** 2))
    return _near(means > LIMIT) | (squares > least_first[max(within - 1, 0)])


def _farthest(depth: np.ndarray) -> np.ndarray:
    """Depth float32 [h, w] of what is farthest in each block or one beside it; infinite where a
    view shows nothing."""
    known = np.where(depth > 0, depth, np.inf)
    height, width = depth.shape
    padded = np.pad(known, ((0, -height % BLOCK), (0, -width % BLOCK)), "edge")
    blocks = padded.reshape(padded.shape[0] // BLOCK, BLOCK, -1, BLOCK).max((1, 3))
    return ndimage.maximum_filter(blocks, 3)


def _summary(changes: Sequence[np.ndarray]) -> Change:
    return Change(
        mean=float(np.mean([change.mean(dtype=np.float64) for change in changes])) / GREY,
        rms=max(float(np.sqrt(np.square(c).mean(dtype=np.float64))) for c in changes) / GREY,
        greatest=max(float(change.max()) for change in changes) / GREY,
    )


class _Level(NamedTuple):
    """Cells of s x s pixels on a grid, float32 but where said.

    Attributes
    ----------
    there : bool [V, h, w]
        Which cells have one Gaussian.
    means : [V, h, w, 3]
    low, high : [V, h, w, C]
        Least and greatest trait in the cell, in units of what traits may differ by.
    widest : [V, h, w]
        Greatest scale in the cell, times s.
    """

    there: np.ndarray
    means: np.ndarray
    low: np.ndarray
    high: np.ndarray
    widest: np.ndarray


@dataclass(frozen=True, eq=False)
class _Grid:
    """Where Gaussians are in the images that they came from.

    Attributes
    ----------
    rows : int64 [V, H, W]
        The first Gaussian of every pixel; -1 where there is none.
    levels : list of _Level
        Of cells of 1, 2, 4 ... pixels along a side.
    """

    rows: np.ndarray
    levels: list[_Level]

    @staticmethod
    def of(gaussians: Gaussians, cameras: Sequence[Camera]) -> _Grid:
        found = {(camera.height, camera.width) for camera in cameras}
        if len(found) != 1:
            raise InputError(f"merge cameras: found sizes {sorted(found)}, expected one size")
        shape = (len(cameras), *found.pop())
        arrays = gaussians.to_arrays()
        source = arrays["source"].astype(np.int64)
        if len(source) and not 0 <= source.min() <= source.max() < np.prod(shape):
            raise InputError(
                f"merge source: found pixels {source.min()} to {source.max()}, expected those of "
                f"{shape[0]} views of {shape[2]}x{shape[1]}"
            )
        rows = np.full(shape, -1, np.int64)
        rows.ravel()[source[::-1]] = np.arange(len(source) - 1, -1, -1)
        levels = [_pixels(rows, gaussians)]
        for _ in range(HALVINGS):
            levels.append(_halved(levels[-1]))
        return _Grid(rows, levels)

    def sizes(self) -> np.ndarray:
        """How many pixels along its side the cell of each pixel has: int64 [V, H, W]."""
        sizes = np.ones(self.rows.shape, np.int64)
        for power, level in enumerate(self.levels[1:], 1):
            _mark(sizes, level.there, 2**power, 2**power)
        return sizes


def _pixels(rows: np.ndarray, gaussians: Gaussians) -> _Level:
    """Return the level of single pixels.

    Its traits are what must be alike, in units of what it may differ by.
    """
    arrays, there = gaussians.to_arrays(), rows >= 0
    traits = [
        arrays["sh"].reshape(len(gaussians), 3 * arrays["sh"].shape[1]) * (SH_C0 / COLOUR),
        arrays["opacities"][:, None] / OPACITY,
    ]
    if "features" in arrays:
        traits.append(arrays["features"] / FEATURE)

    def image(table: np.ndarray) -> np.ndarray:
        made = np.zeros((*rows.shape, *table.shape[1:]), np.float32)
        made[there] = table[rows[there]]
        return made

    low = image(np.concatenate(traits, 1).astype(np.float32, copy=False))
    widest = image(arrays["scales"].max(1, initial=0))
    return _Level(there, image(arrays["means"]), low, low, widest)


def _halved(level: _Level) -> _Level:
    """Return the level of cells twice as large, of which four may become one.

    They are there and alike with the cells around them, close, and nearly a parallelogram.
    """
    a, b, c, d = _corners(level.means)
    reach = np.maximum.reduce(_corners(level.widest))
    spread = _around(np.maximum, level.high) - _around(np.minimum, level.low)
    joined = _around(np.minimum, level.there) & (spread <= 1).all(-1)
    across, down = (np.square(one.astype(np.float64) / 2) for one in (b - a + d - c, c - a + d - b))
    twist = np.square(a - b - c + d)
    wide, high, off = (one[..., 0] + one[..., 1] + one[..., 2] for one in (across, down, twist))
    joined &= np.maximum(wide, high) <= np.square(reach * np.float32(APART))
    joined &= off <= np.float32(BENT) ** 2 * np.minimum(wide, high)

    def only(values: np.ndarray) -> np.ndarray:
        return np.where(joined.reshape(joined.shape + (1,) * (values.ndim - 3)), values, 0)

    low = only(np.minimum.reduce(_corners(level.low)))
    high = only(np.maximum.reduce(_corners(level.high)))
    return _Level(joined, only((a + b + c + d) / 4), low, high, only(2 * reach))


def _corners(values: np.ndarray) -> list[np.ndarray]:
    """The four of each cell of 2x2 of an image [V, H, W, ...], row by row: views [V, h, w, ...]."""
    h, w = values.shape[1] // 2, values.shape[2] // 2
    return [values[:, y : 2 * h : 2, x : 2 * w : 2] for y in (0, 1) for x in (0, 1)]


def _around(best: np.ufunc, values: np.ndarray) -> np.ndarray:
    """``best`` of each cell of 2x2 and those around it, within the image: [V, h, w, ...]."""
    for axis in (1, 2):
        size = values.shape[axis]
        half = size // 2
        values = np.moveaxis(values, axis, 0)
        # From the pixel before each cell to that after it, or to the last.
        before = np.maximum(2 * np.arange(half) - 1, 0)
        after = np.minimum(2 * np.arange(half) + 2, size - 1)
        first, second = values[: 2 * half : 2], values[1 : 2 * half : 2]
        made = best(best(values[before], first), best(second, values[after]))
        values = np.moveaxis(made, 0, axis)
    return values


def _mark(sizes: np.ndarray, there: np.ndarray, side: int, size: int) -> None:
    """Say of the pixels of cells of so many along a side what size they have."""
    whole = there.repeat(side, 1).repeat(side, 2)
    sizes[:, : whole.shape[1], : whole.shape[2]][whole] = size


def _take_back(
    sizes: np.ndarray,
    grid: _Grid,
    over: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
) -> None:
    """Have cells that a view shows in its blocks ``over`` bool [h, w] be single pixels again.

    ``depths`` float32 [h, w] are those behind which nothing shows.
    """
    for power, level in enumerate(grid.levels[1:], 1):
        size = 2**power
        back = np.zeros(level.there.shape, bool)
        _, height, width = level.there.shape  # whole cells: the last row and column may be ragged
        marked = sizes[:, ::size, ::size][:, :height, :width] == size
        v, y, x = np.nonzero(level.there & marked)
        for where, behind, camera in zip(over, depths, cameras, strict=True):
            pixels, z = camera.project(level.means[v, y, x].astype(np.float64))
            # What lies beyond the border reaches the blocks at it, as far as it is wide.
            wide = REACH * float(camera.K[0, 0]) * level.widest[v, y, x] / np.where(z > 0, z, 1)
            beyond = (BLOCK + wide)[:, None]
            inside = (z > 0) & (pixels >= -beyond).all(1)
            inside &= (pixels < (camera.width, camera.height) + beyond).all(1)
            column, row = (np.where(inside[:, None], pixels, 0) // BLOCK).astype(np.int64).T
            row, column = row.clip(0, where.shape[0] - 1), column.clip(0, where.shape[1] - 1)
            back[v, y, x] |= inside & where[row, column] & (z <= (1 + BEHIND) * behind[row, column])
        _mark(sizes, back, size, 1)


def _block_means(change: np.ndarray) -> np.ndarray:
    """Means of blocks of float32 [H, W]; those at the end repeat the last row and column."""
    height, width = change.shape
    padded = np.pad(change, ((0, -height % BLOCK), (0, -width % BLOCK)), "edge")
    rows, columns = padded.shape[0] // BLOCK, padded.shape[1] // BLOCK
    return padded.reshape(rows, BLOCK, columns, BLOCK).mean((1, 3))


def _near(blocks: np.ndarray) -> np.ndarray:
    """Those blocks and all around them: a merged Gaussian reaches into the next."""
    return ndimage.binary_dilation(blocks, np.ones((3, 3), bool))


def _joined(gaussians: Gaussians, grid: _Grid, sizes: np.ndarray) -> tuple[Gaussians, np.ndarray]:
    """One Gaussian for each cell, and for each Gaussian given the place of its own: int64 [N].

    Semantic features are those of the first of each, so that they are still codes; a guess is what
    mostly was one.
    """
    arrays = gaussians.to_arrays()
    leaders = np.arange(len(gaussians))  # of each Gaussian the first of its cell
    v, y, x = np.nonzero(sizes > 1)
    size = sizes[v, y, x]
    leaders[grid.rows[v, y, x]] = grid.rows[v, y - y % size, x - x % size]
    kept = leaders == np.arange(len(gaussians))
    places = np.cumsum(kept) - 1
    left = {name: array[kept] for name, array in arrays.items()}  # copies, which may be written to
    first = (y % size == 0) & (x % size == 0)
    v, y, x = v[first], y[first], x[first]
    cells = np.stack([v, y, x, sizes[v, y, x]], 1)
    to = places[grid.rows[v, y, x]]
    for name in ("means", "opacities", "sh"):
        given, made = arrays[name], left[name]
        table = given.reshape(len(given), int(np.prod(given.shape[1:])))
        values = _average(table, grid.rows, cells)
        made[to] = values.reshape(made[to].shape)
    shape = arrays["means"], arrays["scales"], arrays["quats"]
    left["scales"][to] = _scales(*shape, grid.rows, cells, LOW_PASS)
    if "guessed" in left:
        share = _average(arrays["guessed"][:, None].astype(np.float32), grid.rows, cells)
        left["guessed"][to] = share[:, 0] > 0.5
    return Gaussians.from_arrays(left), places[leaders]


def _members(rows: np.ndarray, cells: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Which of the cells int64 [M, 4] (view, row, column, size) have one size, int64 [K], and the
    Gaussians of their pixels: int64 [K, size, size]; for each size."""
    for size in np.unique(cells[:, 3]).tolist():
        which = np.flatnonzero(cells[:, 3] == size)
        v, top, left = (cells[which, k, None, None] for k in range(3))
        steps = np.arange(size)
        yield which, rows[v, top + steps[:, None], left + steps]


def _average(table: np.ndarray, rows: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Means float32 [M, C] of a table [N, C] over cells int64 [M, 4]: view, row, column, size."""
    means = np.empty((len(cells), table.shape[1]), np.float32)
    for which, members in _members(rows, cells):
        total = np.zeros((len(which), table.shape[1]))
        for one in members.reshape(len(which), -1).T:
            total += table[one]
        means[which] = total / members[0].size
    return means


def _scales(
    means: np.ndarray,
    scales: np.ndarray,
    quats: np.ndarray,
    rows: np.ndarray,
    cells: np.ndarray,
    low_pass: float,
) -> np.ndarray:
    """Scales float32 [M, 3] of the Gaussians of cells, along the axes of the first of each.

    Their views draw a Gaussian as wide as it is and the low-pass together. A merged one is to be as
    many times as wide as its cell, so that it closes the surface as they did: with C the mean
    covariance of its members, s the side and u, v a step to the next pixel on the surface, it has
    ``s^2 C + (s^2 - 1) low_pass (u u^T + v v^T)``.
    """
    made = np.empty((len(cells), 3), np.float32)
    for which, members in _members(rows, cells):
        size = members.shape[1]
        axes = _axes(quats[members[:, 0, 0]])
        spread = np.zeros((len(which), 3))
        for one in members.reshape(len(which), -1).T:
            own, wide = _axes(quats[one]), scales[one]
            for a in range(3):
                for k in range(3):
                    along = _dot(axes[:, a], own[:, k])
                    spread[:, a] += np.square(along * wide[:, k])
        across, down = (_step(means[members], axis) for axis in (2, 1))
        for a in range(3):
            wide, high = _dot(axes[:, a], across.T), _dot(axes[:, a], down.T)
            steps = low_pass * (size * size - 1) * (wide * wide + high * high)
            made[which, a] = np.sqrt(spread[:, a] + steps)
    return made


def _step(places: np.ndarray, axis: int) -> np.ndarray:
    """A step float64 [K, 3] to the next pixel along axis 1 or 2 of places [K, size, size, 3]:
    between the halves of a cell, averaged."""
    size = places.shape[1]
    half = size // 2
    total = np.zeros((len(places), 3))
    for y in range(size):
        for x in range(size):
            sign = 1 if (x if axis == 2 else y) >= half else -1
            total += sign * places[:, y, x].astype(np.float64)
    return total / (size * size / 2 * half)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Dot products [K] of vectors [3, K]."""
    product: np.ndarray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def _axes(quats: np.ndarray) -> np.ndarray:
    """Columns of the rotation matrices of quaternions wxyz float32 [K, 4] of any length but zero:
    float64 [3, 3, K], first the row, then the column."""
    w, x, y, z = quats.T
    t = 2.0 / (w * w + x * x + y * y + z * z).astype(np.float64)
    return np.array(
        [
            [1 - t * (y * y + z * z), t * (x * y - w * z), t * (x * z + w * y)],
            [t * (x * y + w * z), 1 - t * (x * x + z * z), t * (y * z - w * x)],
            [t * (x * z - w * y), t * (y * z + w * x), 1 - t * (x * x + y * y)],
        ]
    )
