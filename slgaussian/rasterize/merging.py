"""Draw what is even with fewer, larger Gaussians, and take back what shows.

A wall of one colour needs no Gaussian a pixel. Where the Gaussians of 2x2 neighbouring pixels, and
of those around them, are alike and lie on one surface, one takes the place of the four, and one of
such four in turn. Then the given views are drawn, and where they changed too much the pixels get
their own Gaussians back. What is left of the change is measured by drawing once more.

Nothing is left out because the given views do not see it: another view may. Dropping what has
little light was tried, and costs more than it saves (`docs/measured/kept.md`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import torch
from scipy import ndimage

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.rasterize.api import rasterize
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
    into: torch.Tensor
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
            return Merged(merged, torch.from_numpy(into), change)
    return Merged(gaussians, torch.arange(len(gaussians)), Change())


def _picture(gaussians: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Colours float32 [H, W, 3] as a field shows them, and depth float32 [H, W]."""
    with torch.no_grad():
        drawn = rasterize(gaussians, None, camera)
    shown = drawn.values / drawn.alpha.clamp_min(VISIBLE)[..., None]
    return shown.clamp(0, 1).cpu().numpy(), drawn.depth.cpu().numpy()


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
        source = gaussians.source.cpu().numpy().astype(np.int64)
        if len(source) and not 0 <= source.min() <= source.max() < np.prod(shape):
            raise InputError(
                f"merge source: found pixels {source.min()} to {source.max()}, expected those of "
                f"{shape[0]} views of {shape[2]}x{shape[1]}"
            )
        rows = np.full(shape, -1, np.int64)
        rows.ravel()[source[::-1]] = np.arange(len(source) - 1, -1, -1)
        arrays = gaussians.to_arrays()
        traits = _traits(gaussians)
        first = _Level(*_spread(rows, arrays["means"], traits, arrays["scales"]))
        levels = [first]
        for _ in range(HALVINGS):
            levels.append(_Level(*_halve(*levels[-1], np.float32(APART), np.float32(BENT))))
        return _Grid(rows, levels)

    def sizes(self) -> np.ndarray:
        """How many pixels along its side the cell of each pixel has: int64 [V, H, W]."""
        sizes = np.ones(self.rows.shape, np.int64)
        for power, level in enumerate(self.levels[1:], 1):
            _mark(sizes, level.there, 2**power, 2**power)
        return sizes


def _traits(gaussians: Gaussians) -> np.ndarray:
    """What must be alike, float32 [N, C], in units of what it may differ by."""
    columns = [
        gaussians.sh.flatten(1) * (SH_C0 / COLOUR),
        gaussians.opacities[:, None] / OPACITY,
    ]
    if gaussians.features is not None:
        columns.append(gaussians.features / FEATURE)
    return torch.cat(columns, 1).detach().cpu().float().numpy()


@numba.njit(cache=True, parallel=True)
def _spread(rows, means, traits, scales):
    """The arrays of a :class:`_Level` of single pixels."""
    V, H, W = rows.shape
    C = traits.shape[1]
    there = np.zeros((V, H, W), np.bool_)
    places = np.zeros((V, H, W, 3), np.float32)
    low = np.zeros((V, H, W, C), np.float32)
    widest = np.zeros((V, H, W), np.float32)
    for line in numba.prange(V * H):
        v, y = line // H, line % H
        for x in range(W):
            i = rows[v, y, x]
            if i >= 0:
                there[v, y, x] = True
                places[v, y, x] = means[i]
                low[v, y, x] = traits[i]
                widest[v, y, x] = max(scales[i, 0], scales[i, 1], scales[i, 2])
    return there, places, low, low, widest


@numba.njit(cache=True, parallel=True)
def _halve(there, means, low, high, widest, apart, bent):
    """The arrays of the next :class:`_Level`: cells of which four may become one."""
    V, H, W, C = low.shape
    h, w = H // 2, W // 2
    joined = np.zeros((V, h, w), np.bool_)
    places = np.zeros((V, h, w, 3), np.float32)
    least = np.zeros((V, h, w, C), np.float32)
    most = np.zeros((V, h, w, C), np.float32)
    wide = np.zeros((V, h, w), np.float32)
    for line in numba.prange(V * h):
        v, y = line // h, line % h
        for x in range(w):
            top, left = 2 * y, 2 * x
            corners = means[v, top : top + 2, left : left + 2]
            reach = widest[v, top : top + 2, left : left + 2].max()
            if not _even(there[v], low[v], high[v], top, left):
                continue
            if not _flat(corners, reach * apart, bent):
                continue
            joined[v, y, x] = True
            wide[v, y, x] = 2 * reach
            for k in range(3):
                places[v, y, x, k] = corners[:, :, k].sum() / 4
            for c in range(C):
                least[v, y, x, c] = low[v, top : top + 2, left : left + 2, c].min()
                most[v, y, x, c] = high[v, top : top + 2, left : left + 2, c].max()
    return joined, places, least, most, wide


@numba.njit(cache=True)
def _even(there, low, high, top, left):
    """Whether a cell of 2x2 and the cells around it are there and alike."""
    H, W, C = low.shape
    up, down = max(0, top - 1), min(H, top + 3)
    first, last = max(0, left - 1), min(W, left + 3)
    for y in range(up, down):
        for x in range(first, last):
            if not there[y, x]:
                return False
    for c in range(C):
        least, most = low[top, left, c], high[top, left, c]
        for y in range(up, down):
            for x in range(first, last):
                least, most = min(least, low[y, x, c]), max(most, high[y, x, c])
        if most - least > 1:
            return False
    return True


@numba.njit(cache=True)
def _flat(corners, apart, bent):
    """Whether 2x2 places [2, 2, 3] are close, and nearly a parallelogram."""
    across = down = twist = np.float32(0)
    for k in range(3):
        a, b, c, d = corners[0, 0, k], corners[0, 1, k], corners[1, 0, k], corners[1, 1, k]
        across += ((b - a + d - c) / 2) ** 2
        down += ((c - a + d - b) / 2) ** 2
        twist += (a - b - c + d) ** 2
    return max(across, down) <= apart * apart and twist <= bent * bent * min(across, down)


@numba.njit(cache=True)
def _mark(sizes, there, side, size):
    """Say of the pixels of cells of so many along a side what size they have."""
    for v, y, x in np.argwhere(there):
        sizes[v, y * side : (y + 1) * side, x * side : (x + 1) * side] = size


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
        v, y, x = np.nonzero(level.there & (sizes[:, ::size, ::size] == size)[_within(level)])
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


def _within(level: _Level) -> tuple[slice, ...]:
    """The whole cells of a grid, of which the last row and column may be ragged."""
    return (slice(None), *(slice(side) for side in level.there.shape[1:]))


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
    leaders = _leaders(grid.rows, sizes, len(gaussians))
    kept = leaders == np.arange(len(gaussians))
    places = np.cumsum(kept) - 1
    left = gaussians[torch.from_numpy(np.flatnonzero(kept))]  # a copy, which may be written to
    v, y, x = _merged_cells(grid.rows, sizes)
    cells = np.stack([v, y, x, sizes[v, y, x]], 1)
    to = torch.from_numpy(places[grid.rows[v, y, x]])
    for name in ("means", "opacities", "sh"):
        given, made = arrays[name], getattr(left, name)
        table = given.reshape(len(given), int(np.prod(given.shape[1:])))
        values = torch.from_numpy(_average(table, grid.rows, cells))
        made[to] = values.reshape(made[to].shape)
    shape = arrays["means"], arrays["scales"], arrays["quats"]
    left.scales[to] = torch.from_numpy(_scales(*shape, grid.rows, cells, LOW_PASS))
    if left.guessed is not None:
        share = _average(arrays["guessed"][:, None].astype(np.float32), grid.rows, cells)
        left.guessed[to] = torch.from_numpy(share[:, 0] > 0.5)
    return left, places[leaders]


@numba.njit(cache=True)
def _leaders(rows, sizes, n):
    """For each Gaussian the first one of its cell, int64 [N]; those of no pixel lead themselves."""
    leaders = np.arange(n)
    V, H, W = rows.shape
    for v in range(V):
        for y in range(H):
            for x in range(W):
                size = sizes[v, y, x]
                if size > 1:
                    leaders[rows[v, y, x]] = rows[v, y - y % size, x - x % size]
    return leaders


def _merged_cells(rows: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, ...]:
    """View, row and column of the first pixel of every cell of more than one."""
    _, height, width = rows.shape
    y, x = np.arange(height)[:, None], np.arange(width)
    return np.nonzero((sizes > 1) & (y % sizes == 0) & (x % sizes == 0))


@numba.njit(cache=True, parallel=True)
def _average(table, rows, cells):
    """Means float32 [M, C] of a table [N, C] over cells int64 [M, 4]: view, row, column, size."""
    M, C = len(cells), table.shape[1]
    means = np.empty((M, C), np.float32)
    for m in numba.prange(M):
        v, top, left, size = cells[m]
        for c in range(C):
            total = 0.0
            for y in range(top, top + size):
                for x in range(left, left + size):
                    total += table[rows[v, y, x], c]
            means[m, c] = total / (size * size)
    return means


@numba.njit(cache=True, parallel=True)
def _scales(means, scales, quats, rows, cells, low_pass):
    """Scales float32 [M, 3] of the Gaussians of cells, along the axes of the first of each.

    Their views draw a Gaussian as wide as it is and the low-pass together. A merged one is to be as
    many times as wide as its cell, so that it closes the surface as they did: with C the mean
    covariance of its members, s the side and u, v a step to the next pixel on the surface, it has
    ``s^2 C + (s^2 - 1) low_pass (u u^T + v v^T)``.
    """
    made = np.empty((len(cells), 3), np.float32)
    for m in numba.prange(len(cells)):
        v, top, left, size = cells[m]
        axes = _axes(quats[rows[v, top, left]])
        spread = np.zeros(3)
        for y in range(top, top + size):
            for x in range(left, left + size):
                i = rows[v, y, x]
                own = _axes(quats[i])
                for a in range(3):
                    for k in range(3):
                        along = 0.0
                        for j in range(3):
                            along += axes[j, a] * own[j, k]
                        spread[a] += (along * scales[i, k]) ** 2
        half = size // 2
        for a in range(3):
            across = down = 0.0
            for j in range(3):
                across += axes[j, a] * _step(means, rows[v], top, left, size, half, j, True)
                down += axes[j, a] * _step(means, rows[v], top, left, size, half, j, False)
            steps = low_pass * (size * size - 1) * (across * across + down * down)
            made[m, a] = np.sqrt(spread[a] + steps)
    return made


@numba.njit(cache=True)
def _step(means, rows, top, left, size, half, axis, across):
    """A step to the next pixel along one axis of space: between the halves of a cell, averaged."""
    total = 0.0
    for y in range(size):
        for x in range(size):
            sign = 1 if (x if across else y) >= half else -1
            total += sign * means[rows[top + y, left + x], axis]
    return total / (size * size / 2 * half)


@numba.njit(cache=True)
def _axes(quat):
    """Rotation matrix [3, 3] of a quaternion wxyz of any length but zero."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    t = 2.0 / (w * w + x * x + y * y + z * z)
    made = np.empty((3, 3))
    made[0] = 1 - t * (y * y + z * z), t * (x * y - w * z), t * (x * z + w * y)
    made[1] = t * (x * y + w * z), 1 - t * (x * x + z * z), t * (y * z - w * x)
    made[2] = t * (x * z - w * y), t * (y * z + w * x), 1 - t * (x * x + y * y)
    return made
