"""Merging of uniform Gaussians into fewer, larger ones, with a bound on the visible change.

A wall of one colour does not need a Gaussian for each pixel. Where the Gaussians of 2x2 adjacent
pixels and their neighbours are similar and lie on one surface, one replaces the four; this is
repeated once. Then the context views are rendered, and where they changed too much the merge is
undone. The remaining change is measured by another rendering.

Gaussians that are invisible in the context views remain, as another view may show them. Pruning by
weight was tried and costs more than it saves (`docs/measured/rasterizer.md`).
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
"""Largest range within a merged cell and its neighbours: of a colour, of opacity and of a semantic
feature. With a looser range of colours more merges are undone: at 24 grey levels up to 0.05 more of
the Gaussians remain, at 12 up to 0.02."""

HALVINGS = 2
"""Number of 2x2 merges. A third leaves as many Gaussians and adds a tenth to the error."""

APART = 6.0
"""Distance of neighbours, in standard deviations of the wider one, above which a surface ends."""

BENT = 2.0
"""Largest deviation of four neighbours from a parallelogram, in units of its shorter side. Depth
noise is that large, and it is hardly visible along the line of sight."""

BLOCK = 4
"""Side of the blocks of pixels in which changes are measured."""

LIMIT = 2 * GREY
"""Mean change of a block above which its merges are undone."""

MOST = GREY
"""Largest root mean square change of a context view."""

AIM = 0.9
"""Target of the change of a view above :data:`MOST`, as a share of it: undoing a block changes its
neighbours as well."""

ROUNDS = 2
"""Number of rounds in which the greatest changes of a view above :data:`MOST` are undone; after
them all merges visible in the view are undone."""

BEHIND = 0.1
"""Relative depth behind the visible surface beyond which a Gaussian counts as occluded. In wide
scenes with many views, most Gaussians are occluded in most views."""

REACH = 3.0
"""Visible extent of a Gaussian, in standard deviations."""

LOW_PASS = PRESETS["fast"].low_pass

VISIBLE = 0.5
"""Smallest opacity at which the mean colour is fully shown, as in renderings of fields."""


@dataclass(frozen=True)
class Change:
    """Change of the context views by merging, in grey levels over all channels of all pixels.

    Attributes:
        mean: Mean absolute change.
        rms: Root of the mean square change, of the view where it is greatest.
        greatest: Of any channel of any pixel.
    """

    mean: float = 0.0
    rms: float = 0.0
    greatest: float = 0.0


@dataclass(frozen=True, eq=False)
class Merged:
    """Result of :func:`merge`.

    Attributes:
        gaussians: In the order of the input; ``source`` of a merged one is the first of its pixels.
        into: int64 [N]. Index of the output for each input Gaussian.
    """

    gaussians: Gaussians
    into: np.ndarray
    change: Change


def merge(gaussians: Gaussians, cameras: Sequence[Camera]) -> Merged:
    """Merge Gaussians of neighbouring pixels without visible change of the context views.

    No view changes by more than a grey level (:data:`MOST`, see :class:`Change`). Where one would,
    the merges in its blocks of greatest change are undone.

    Args:
        gaussians: ``source`` has their pixels; only the first Gaussian of a pixel is merged. With
            semantic features, only Gaussians of one object are merged.
        cameras: sequence of V Camera. Context views in their order, all of one size.

    Raises:
        InputError: If there is no camera, they differ in size, or a source is outside of them.
    """
    grid = _Grid.of(gaussians, cameras)
    sizes = grid.sizes()
    pictures = [_picture(gaussians, camera) for camera in cameras]
    before, depths = (
        [picture for picture, _ in pictures],
        [_farthest(depth) for _, depth in pictures],
    )
    merged, into = _merge_cells(gaussians, grid, sizes)
    changes = _changes(merged, cameras, before)
    for attempt in range(ROUNDS + 1):
        over = [_blocks_to_restore(change) for change in changes]
        if attempt == ROUNDS:
            # Include Gaussians behind surfaces, which may shine through.
            for v in (
                v for v, change_v in enumerate(changes) if _summary([change_v]).rms > MOST / GREY
            ):
                over[v], depths[v] = np.ones_like(over[v]), np.full_like(depths[v], np.inf)
        _restore_cells(sizes, grid, over, cameras, depths)
        merged, into = _merge_cells(gaussians, grid, sizes)
        changes = _changes(merged, cameras, before)
        change = _summary(changes)
        if change.rms <= MOST / GREY:
            return Merged(merged, into, change)
    return Merged(gaussians, np.arange(len(gaussians)), Change())


def _picture(gaussians: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Render colours float32 [H, W, 3] as a field does, and depth float32 [H, W]."""
    drawn = picture(gaussians, seen_colors(gaussians, camera), camera)
    color = drawn.values / np.maximum(drawn.alpha, np.float32(VISIBLE))[..., None]
    return color.clip(0, 1), drawn.depth


def _changes(
    gaussians: Gaussians, cameras: Sequence[Camera], before: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Return the absolute change of each view, float32 [H, W, 3]."""
    return [
        np.abs(_picture(gaussians, camera)[0] - original)
        for camera, original in zip(cameras, before, strict=True)
    ]


def _blocks_to_restore(change: np.ndarray) -> np.ndarray:
    """Return the blocks with too much change, alone or in the sum of a view, bool [h, w]."""
    means = _block_means(change.mean(2))
    squares = _block_means(np.square(change).mean(2))
    least_first = np.sort(squares, axis=None)
    sums = np.cumsum(least_first, dtype=np.float64)
    if sums[-1] <= squares.size * MOST**2:
        return _dilate(means > LIMIT)
    within = int(np.searchsorted(sums, squares.size * (AIM * MOST) ** 2))
    return _dilate(means > LIMIT) | (squares > least_first[max(within - 1, 0)])


def _farthest(depth: np.ndarray) -> np.ndarray:
    """Return the greatest depth in each block and its neighbours, float32 [h, w]; infinite where
    nothing is drawn."""
    valid = np.where(depth > 0, depth, np.inf)
    height, width = depth.shape
    padded = np.pad(valid, ((0, -height % BLOCK), (0, -width % BLOCK)), "edge")
    blocks = padded.reshape(padded.shape[0] // BLOCK, BLOCK, -1, BLOCK).max((1, 3))
    return ndimage.maximum_filter(blocks, 3)


def _summary(changes: Sequence[np.ndarray]) -> Change:
    return Change(
        mean=float(np.mean([change.mean(dtype=np.float64) for change in changes])) / GREY,
        rms=max(float(np.sqrt(np.square(c).mean(dtype=np.float64))) for c in changes) / GREY,
        greatest=max(float(change.max()) for change in changes) / GREY,
    )


class _Level(NamedTuple):
    """Cells of s x s pixels on a grid; float32 unless stated.

    Attributes:
        present: bool [V, h, w]. Mask of the cells with one Gaussian.
        means: [V, h, w, 3]
        low, high: [V, h, w, C]. Smallest and greatest attributes in the cell, in units of their
            allowed range.
        widest: [V, h, w]. Greatest scale in the cell, times s.
    """

    present: np.ndarray
    means: np.ndarray
    low: np.ndarray
    high: np.ndarray
    widest: np.ndarray


@dataclass(frozen=True, eq=False)
class _Grid:
    """Gaussians on the pixel grids of their source images.

    Attributes:
        rows: int64 [V, H, W]. The first Gaussian of every pixel; -1 where there is none.
        levels: list of _Level. Of cells of 1, 2, 4 ... pixels along a side.
    """

    rows: np.ndarray
    levels: list[_Level]

    @staticmethod
    def of(gaussians: Gaussians, cameras: Sequence[Camera]) -> _Grid:
        image_sizes = {(camera.height, camera.width) for camera in cameras}
        if len(image_sizes) != 1:
            raise InputError(f"merge cameras: found sizes {sorted(image_sizes)}, expected one size")
        shape = (len(cameras), *image_sizes.pop())
        arrays = gaussians.to_arrays()
        source = arrays["source"].astype(np.int64)
        if len(source) and not 0 <= source.min() <= source.max() < np.prod(shape):
            raise InputError(
                f"merge source: found pixels {source.min()} to {source.max()}, expected those of "
                f"{shape[0]} views of {shape[2]}x{shape[1]}"
            )
        rows = np.full(shape, -1, np.int64)
        rows.ravel()[source[::-1]] = np.arange(len(source) - 1, -1, -1)
        levels = [_pixel_level(rows, gaussians)]
        for _ in range(HALVINGS):
            levels.append(_merge_level(levels[-1]))
        return _Grid(rows, levels)

    def sizes(self) -> np.ndarray:
        """Return the side in pixels of the cell of each pixel, int64 [V, H, W]."""
        sizes = np.ones(self.rows.shape, np.int64)
        for power, level in enumerate(self.levels[1:], 1):
            _mark(sizes, level.present, 2**power, 2**power)
        return sizes


def _pixel_level(rows: np.ndarray, gaussians: Gaussians) -> _Level:
    """Return the level of single pixels.

    Its attributes are in units of their allowed range.
    """
    arrays, present = gaussians.to_arrays(), rows >= 0
    traits = [
        arrays["sh"].reshape(len(gaussians), 3 * arrays["sh"].shape[1]) * (SH_C0 / COLOUR),
        arrays["opacities"][:, None] / OPACITY,
    ]
    if "features" in arrays:
        traits.append(arrays["features"] / FEATURE)

    def image(table: np.ndarray) -> np.ndarray:
        out = np.zeros((*rows.shape, *table.shape[1:]), np.float32)
        out[present] = table[rows[present]]
        return out

    low = image(np.concatenate(traits, 1).astype(np.float32, copy=False))
    widest = image(arrays["scales"].max(1, initial=0))
    return _Level(present, image(arrays["means"]), low, low, widest)


def _merge_level(level: _Level) -> _Level:
    """Return the level of cells twice as large that may be merged.

    Their four parts are present, similar to each other and their neighbours, close, and nearly a
    parallelogram.
    """
    a, b, c, d = _corners(level.means)
    reach = np.maximum.reduce(_corners(level.widest))
    spread = _reduce_around(np.maximum, level.high) - _reduce_around(np.minimum, level.low)
    joined = _reduce_around(np.minimum, level.present) & (spread <= 1).all(-1)
    across, down = (
        np.square(step.astype(np.float64) / 2) for step in (b - a + d - c, c - a + d - b)
    )
    twist = np.square(a - b - c + d)
    wide, high, off = (v[..., 0] + v[..., 1] + v[..., 2] for v in (across, down, twist))
    joined &= np.maximum(wide, high) <= np.square(reach * np.float32(APART))
    joined &= off <= np.float32(BENT) ** 2 * np.minimum(wide, high)

    def only(values: np.ndarray) -> np.ndarray:
        return np.where(joined.reshape(joined.shape + (1,) * (values.ndim - 3)), values, 0)

    low = only(np.minimum.reduce(_corners(level.low)))
    high = only(np.maximum.reduce(_corners(level.high)))
    return _Level(joined, only((a + b + c + d) / 4), low, high, only(2 * reach))


def _corners(values: np.ndarray) -> list[np.ndarray]:
    """Return the four elements of each 2x2 cell of an image [V, H, W, ...] as [V, h, w, ...]."""
    h, w = values.shape[1] // 2, values.shape[2] // 2
    return [values[:, y : 2 * h : 2, x : 2 * w : 2] for y in (0, 1) for x in (0, 1)]


def _reduce_around(best: np.ufunc, values: np.ndarray) -> np.ndarray:
    """Reduce each 2x2 cell and its neighbours within the image by ``best``, [V, h, w, ...]."""
    for axis in (1, 2):
        size = values.shape[axis]
        half = size // 2
        values = np.moveaxis(values, axis, 0)
        # From the pixel before each cell to the one after it, within the image.
        before = np.maximum(2 * np.arange(half) - 1, 0)
        after = np.minimum(2 * np.arange(half) + 2, size - 1)
        first, second = values[: 2 * half : 2], values[1 : 2 * half : 2]
        extreme = best(best(values[before], first), best(second, values[after]))
        values = np.moveaxis(extreme, 0, axis)
    return values


def _mark(sizes: np.ndarray, cells: np.ndarray, side: int, size: int) -> None:
    """Set the size of the pixels of the masked cells of ``side`` pixels."""
    pixels = cells.repeat(side, 1).repeat(side, 2)
    sizes[:, : pixels.shape[1], : pixels.shape[2]][pixels] = size


def _restore_cells(
    sizes: np.ndarray,
    grid: _Grid,
    over: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
) -> None:
    """Undo the merge of cells that are visible in the blocks ``over`` bool [h, w] of a view.

    ``depths`` float32 [h, w] are the depths of the visible surfaces.
    """
    for power, level in enumerate(grid.levels[1:], 1):
        size = 2**power
        back = np.zeros(level.present.shape, bool)
        _, height, width = level.present.shape  # whole cells: the last row and column may be ragged
        marked = sizes[:, ::size, ::size][:, :height, :width] == size
        v, y, x = np.nonzero(level.present & marked)
        for blocks, block_depth, camera in zip(over, depths, cameras, strict=True):
            pixels, z = camera.project(level.means[v, y, x].astype(np.float64))
            # Gaussians beyond the border extend into the blocks at it.
            wide = REACH * float(camera.K[0, 0]) * level.widest[v, y, x] / np.where(z > 0, z, 1)
            beyond = (BLOCK + wide)[:, None]
            inside = (z > 0) & (pixels >= -beyond).all(1)
            inside &= (pixels < (camera.width, camera.height) + beyond).all(1)
            column, row = (np.where(inside[:, None], pixels, 0) // BLOCK).astype(np.int64).T
            row, column = row.clip(0, blocks.shape[0] - 1), column.clip(0, blocks.shape[1] - 1)
            back[v, y, x] |= (
                inside & blocks[row, column] & (z <= (1 + BEHIND) * block_depth[row, column])
            )
        _mark(sizes, back, size, 1)


def _block_means(change: np.ndarray) -> np.ndarray:
    """Return the means of blocks of float32 [H, W], padded by replication."""
    height, width = change.shape
    padded = np.pad(change, ((0, -height % BLOCK), (0, -width % BLOCK)), "edge")
    rows, columns = padded.shape[0] // BLOCK, padded.shape[1] // BLOCK
    return padded.reshape(rows, BLOCK, columns, BLOCK).mean((1, 3))


def _dilate(blocks: np.ndarray) -> np.ndarray:
    """Dilate the mask by one block, as a merged Gaussian extends into the next."""
    return ndimage.binary_dilation(blocks, np.ones((3, 3), bool))


def _merge_cells(
    gaussians: Gaussians, grid: _Grid, sizes: np.ndarray
) -> tuple[Gaussians, np.ndarray]:
    """Return one Gaussian for each cell, and its index for each input Gaussian, int64 [N].

    Semantic features are those of the first member, so that they remain valid codes; ``guessed`` is
    decided by majority.
    """
    arrays = gaussians.to_arrays()
    leaders = np.arange(len(gaussians))  # of each Gaussian the first of its cell
    v, y, x = np.nonzero(sizes > 1)
    size = sizes[v, y, x]
    leaders[grid.rows[v, y, x]] = grid.rows[v, y - y % size, x - x % size]
    is_leader = leaders == np.arange(len(gaussians))
    places = np.cumsum(is_leader) - 1
    arrays_out = {
        name: array[is_leader] for name, array in arrays.items()
    }  # copies, which may be written to
    first = (y % size == 0) & (x % size == 0)
    v, y, x = v[first], y[first], x[first]
    cells = np.stack([v, y, x, sizes[v, y, x]], 1)
    to = places[grid.rows[v, y, x]]
    for name in ("means", "opacities", "sh"):
        original, merged = arrays[name], arrays_out[name]
        table = original.reshape(len(original), int(np.prod(original.shape[1:])))
        values = _average(table, grid.rows, cells)
        merged[to] = values.reshape(merged[to].shape)
    shape = arrays["means"], arrays["scales"], arrays["quats"]
    arrays_out["scales"][to] = _scales(*shape, grid.rows, cells, LOW_PASS)
    if "guessed" in arrays_out:
        share = _average(arrays["guessed"][:, None].astype(np.float32), grid.rows, cells)
        arrays_out["guessed"][to] = share[:, 0] > 0.5
    return Gaussians.from_arrays(arrays_out), places[leaders]


def _members(rows: np.ndarray, cells: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield, for each size, the indices int64 [K] of the cells int64 [M, 4] (view, row, column,
    size) of that size, and the Gaussians of their pixels, int64 [K, size, size]."""
    for size in np.unique(cells[:, 3]).tolist():
        which = np.flatnonzero(cells[:, 3] == size)
        v, top, left = (cells[which, k, None, None] for k in range(3))
        steps = np.arange(size)
        yield which, rows[v, top + steps[:, None], left + steps]


def _average(table: np.ndarray, rows: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Average a table [N, C] over cells int64 [M, 4] (view, row, column, size), float32 [M, C]."""
    means = np.empty((len(cells), table.shape[1]), np.float32)
    for which, members in _members(rows, cells):
        total = np.zeros((len(which), table.shape[1]))
        for rows_of_pixel in members.reshape(len(which), -1).T:
            total += table[rows_of_pixel]
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
    """Compute scales float32 [M, 3] of merged Gaussians, along the axes of their first members.

    A view draws a Gaussian widened by the low-pass filter. The drawn width of a merged Gaussian is
    scaled with the side of its cell, so that the surface stays closed: with C the mean covariance
    of its members, s the side and u, v the steps to the next pixel on the surface, its covariance
    is ``s^2 C + (s^2 - 1) low_pass (u u^T + v v^T)``.
    """
    out = np.empty((len(cells), 3), np.float32)
    for which, members in _members(rows, cells):
        size = members.shape[1]
        axes = _axes(quats[members[:, 0, 0]])
        spread = np.zeros((len(which), 3))
        for rows_of_pixel in members.reshape(len(which), -1).T:
            member_axes, wide = _axes(quats[rows_of_pixel]), scales[rows_of_pixel]
            for a in range(3):
                for k in range(3):
                    along = _dot(axes[:, a], member_axes[:, k])
                    spread[:, a] += np.square(along * wide[:, k])
        across, down = (_step(means[members], axis) for axis in (2, 1))
        for a in range(3):
            wide, high = _dot(axes[:, a], across.T), _dot(axes[:, a], down.T)
            steps = low_pass * (size * size - 1) * (wide * wide + high * high)
            out[which, a] = np.sqrt(spread[:, a] + steps)
    return out


def _step(places: np.ndarray, axis: int) -> np.ndarray:
    """Return the mean step float64 [K, 3] to the next pixel along axis 1 or 2 of positions
    [K, size, size, 3], from the difference between the halves of a cell."""
    size = places.shape[1]
    half = size // 2
    total = np.zeros((len(places), 3))
    for y in range(size):
        for x in range(size):
            sign = 1 if (x if axis == 2 else y) >= half else -1
            total += sign * places[:, y, x].astype(np.float64)
    return total / (size * size / 2 * half)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the dot products [K] of vectors [3, K]."""
    product: np.ndarray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def _axes(quats: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of quaternions wxyz float32 [K, 4] of any nonzero length, with
    the axis last, float64 [3, 3, K]."""
    w, x, y, z = quats.T
    t = 2.0 / (w * w + x * x + y * y + z * z).astype(np.float64)
    return np.array(
        [
            [1 - t * (y * y + z * z), t * (x * y - w * z), t * (x * z + w * y)],
            [t * (x * y + w * z), 1 - t * (x * x + z * z), t * (y * z - w * x)],
            [t * (x * z - w * y), t * (y * z + w * x), 1 - t * (x * x + y * y)],
        ]
    )
