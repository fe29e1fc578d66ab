"""Merging of uniform Gaussians into fewer, larger ones, with a bound on the visible change.

A wall of one colour does not need a Gaussian for each pixel. Where the Gaussians of 2x2 adjacent
pixels and their neighbours are similar and lie on one surface, one replaces the four; this is
repeated once. Then the context views are rendered, and where they changed too much the merge is
undone. The remaining change is measured by another rendering.

Gaussians that are invisible in the context views remain, as another view may show them. Pruning by
weight was tried and costs more than it saves (`docs/measured/earlier.md`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.rasterize.picture import compute_view_colours, picture
from slgaussian.rasterize.render_settings import PRESETS
from slgaussian.scene import Camera

GREY_LEVEL = 1 / 255

MAX_COLOUR_RANGE, MAX_OPACITY_RANGE, MAX_FEATURE_RANGE = 16 * GREY_LEVEL, 0.1, 1 / 64
"""Largest range within a merged cell and its neighbours: of a colour, of opacity and of a semantic
feature. With a looser range of colours more merges are undone: at 24 grey levels up to 0.05 more of
the Gaussians remain, at 12 up to 0.02."""

HALVINGS = 2
"""Number of 2x2 merges. A third leaves as many Gaussians and adds a tenth to the error."""

MAX_NEIGHBOUR_DISTANCE = 6.0
"""Distance of neighbours, in standard deviations of the wider one, above which a surface ends."""

MAX_BEND = 2.0
"""Largest deviation of four neighbours from a parallelogram, in units of its shorter side. Depth
noise is that large, and it is hardly visible along the line of sight."""

BLOCK_SIDE = 4
"""Side of the blocks of pixels in which changes are measured."""

MAX_BLOCK_CHANGE = 2 * GREY_LEVEL
"""Mean change of a block above which its merges are undone."""

MAX_VIEW_CHANGE = GREY_LEVEL
"""Largest root mean square change of a context view."""

TARGET_SHARE = 0.9
"""Target of the change of a view above :data:`MAX_VIEW_CHANGE`, as a share of it: undoing a block
changes its neighbours as well."""

UNDO_ROUNDS = 2
"""Number of rounds in which the greatest changes of a view above :data:`MAX_VIEW_CHANGE` are
undone; after them all merges visible in the view are undone."""

OCCLUSION_TOLERANCE = 0.1
"""Relative depth behind the visible surface beyond which a Gaussian counts as occluded. In wide
scenes with many views, most Gaussians are occluded in most views."""

EXTENT = 3.0
"""Visible extent of a Gaussian, in standard deviations."""

LOW_PASS = PRESETS["fast"].low_pass

MIN_OPACITY = 0.5
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


class Merged(NamedTuple):
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

    No view changes by more than a grey level (:data:`MAX_VIEW_CHANGE`, see :class:`Change`). Where
    one would, the merges in its blocks of greatest change are undone.

    Args:
        gaussians: ``source`` has their pixels; only the first Gaussian of a pixel is merged. With
            semantic features, only Gaussians of one object are merged.
        cameras: sequence of V Camera. Context views in their order, all of one size.

    Raises:
        InputError: If there is no camera, they differ in size, or a source is outside of them.
    """
    rows = _rows_of_pixels(gaussians.to_arrays()["source"], cameras)
    local_cameras = [gaussians.localize(camera) for camera in cameras]
    levels = [_pixel_level(rows, gaussians)]
    sizes = np.ones(rows.shape, np.int64)  # side of the cell of each pixel
    for power in range(1, HALVINGS + 1):
        levels.append(_merge_level(levels[-1]))
        _mark(sizes, levels[-1].present, 2**power, 2**power)
    before, drawn_depths = zip(*(_picture(gaussians, camera) for camera in cameras), strict=True)
    # The farthest depth around each block; infinite where nothing is drawn.
    depths = [
        ndimage.maximum_filter(_blocks(np.where(depth > 0, depth, np.inf)).max((1, 3)), 3)
        for depth in drawn_depths
    ]
    for attempt in range(UNDO_ROUNDS + 2):
        merged, into = _merge_cells(gaussians, rows, sizes)
        changes = [
            np.abs(_picture(merged, camera)[0] - original)
            for camera, original in zip(cameras, before, strict=True)
        ]
        squares = [np.square(change).mean(dtype=np.float64) for change in changes]
        if attempt and max(squares) <= MAX_VIEW_CHANGE**2:
            change = Change(
                mean=float(np.mean([change.mean(dtype=np.float64) for change in changes]))
                / GREY_LEVEL,
                rms=float(np.sqrt(max(squares))) / GREY_LEVEL,
                greatest=max(float(change.max()) for change in changes) / GREY_LEVEL,
            )
            return Merged(merged, into, change)
        restored = [_blocks_to_restore(change) for change in changes]
        if attempt == UNDO_ROUNDS:
            # Include Gaussians behind surfaces, which may shine through.
            for v in np.flatnonzero(np.array(squares) > MAX_VIEW_CHANGE**2):
                restored[v], depths[v] = np.ones_like(restored[v]), np.full_like(depths[v], np.inf)
        _restore_cells(sizes, levels, restored, local_cameras, depths)
    return Merged(gaussians, np.arange(len(gaussians)), Change())


def _rows_of_pixels(source: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """Return the first Gaussian of every pixel, int64 [V, H, W]; -1 where there is none."""
    image_sizes = {(camera.height, camera.width) for camera in cameras}
    if len(image_sizes) != 1:
        raise InputError(f"merge cameras: found sizes {sorted(image_sizes)}, expected one size")
    shape = (len(cameras), *image_sizes.pop())
    if len(source) and not 0 <= source.min() <= source.max() < np.prod(shape):
        raise InputError(
            f"merge source: found pixels {source.min()} to {source.max()}, expected those of "
            f"{shape[0]} views of {shape[2]}x{shape[1]}"
        )
    rows = np.full(shape, -1, np.int64)
    rows.ravel()[source[::-1]] = np.arange(len(source) - 1, -1, -1)
    return rows


def _picture(gaussians: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Render colours float32 [H, W, 3] as a field does, and depth float32 [H, W]."""
    drawn = picture(gaussians, compute_view_colours(gaussians, camera), camera)
    colour = drawn.values / np.maximum(drawn.alpha, np.float32(MIN_OPACITY))[..., None]
    return colour.clip(0, 1), drawn.depth


def _blocks_to_restore(change: np.ndarray) -> np.ndarray:
    """Return the blocks with too much change, alone or in the sum of a view, bool [h, w]."""
    means = _blocks(change.mean(2)).mean((1, 3))
    squares = _blocks(np.square(change).mean(2)).mean((1, 3))
    # Dilated by one block, as a merged Gaussian extends into the next.
    excessive = ndimage.binary_dilation(means > MAX_BLOCK_CHANGE, np.ones((3, 3), bool))
    least_first = np.sort(squares, axis=None)
    sums = np.cumsum(least_first, dtype=np.float64)
    if sums[-1] <= squares.size * MAX_VIEW_CHANGE**2:
        return excessive
    count = int(np.searchsorted(sums, squares.size * (TARGET_SHARE * MAX_VIEW_CHANGE) ** 2))
    return excessive | (squares > least_first[max(count - 1, 0)])


def _blocks(values: np.ndarray) -> np.ndarray:
    """Split an image [H, W], padded by replication, into blocks [h, BLOCK_SIDE, w, BLOCK_SIDE]."""
    height, width = values.shape
    padded = np.pad(values, ((0, -height % BLOCK_SIDE), (0, -width % BLOCK_SIDE)), "edge")
    return padded.reshape(padded.shape[0] // BLOCK_SIDE, BLOCK_SIDE, -1, BLOCK_SIDE)


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


def _pixel_level(rows: np.ndarray, gaussians: Gaussians) -> _Level:
    """Return the level of single pixels.

    Its attributes are in units of their allowed range.
    """
    arrays, present = gaussians.to_arrays(), rows >= 0
    traits = [
        arrays["sh"].reshape(len(gaussians), 3 * arrays["sh"].shape[1])
        * (SH_C0 / MAX_COLOUR_RANGE),
        arrays["opacities"][:, None] / MAX_OPACITY_RANGE,
    ]
    if "features" in arrays:
        traits.append(arrays["features"] / MAX_FEATURE_RANGE)

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
    joined &= np.maximum(wide, high) <= np.square(reach * np.float32(MAX_NEIGHBOUR_DISTANCE))
    joined &= off <= np.float32(MAX_BEND) ** 2 * np.minimum(wide, high)

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
    levels: Sequence[_Level],
    over: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
) -> None:
    """Undo the merge of cells that are visible in the blocks ``over`` bool [h, w] of a view.

    ``depths`` float32 [h, w] are the depths of the visible surfaces.
    """
    for power, level in enumerate(levels[1:], 1):
        size = 2**power
        back = np.zeros(level.present.shape, bool)
        _, height, width = level.present.shape  # whole cells: the last row and column may be ragged
        marked = sizes[:, ::size, ::size][:, :height, :width] == size
        v, y, x = np.nonzero(level.present & marked)
        for blocks, block_depth, camera in zip(over, depths, cameras, strict=True):
            pixels, z = camera.project(level.means[v, y, x].astype(np.float64))
            # Gaussians beyond the border extend into the blocks at it.
            wide = EXTENT * float(camera.K[0, 0]) * level.widest[v, y, x] / np.where(z > 0, z, 1)
            beyond = (BLOCK_SIDE + wide)[:, None]
            inside = (z > 0) & (pixels >= -beyond).all(1)
            inside &= (pixels < (camera.width, camera.height) + beyond).all(1)
            column, row = (np.where(inside[:, None], pixels, 0) // BLOCK_SIDE).astype(np.int64).T
            row, column = row.clip(0, blocks.shape[0] - 1), column.clip(0, blocks.shape[1] - 1)
            back[v, y, x] |= (
                inside
                & blocks[row, column]
                & (z <= (1 + OCCLUSION_TOLERANCE) * block_depth[row, column])
            )
        _mark(sizes, back, size, 1)


def _merge_cells(
    gaussians: Gaussians, rows: np.ndarray, sizes: np.ndarray
) -> tuple[Gaussians, np.ndarray]:
    """Return one Gaussian for each cell, and its index for each input Gaussian, int64 [N].

    Semantic features are those of the first member, so that they remain valid codes; ``guessed`` is
    decided by majority.
    """
    arrays = gaussians.to_arrays()
    arrays_out = {name: array.copy() for name, array in arrays.items() if name != "origin"}
    leaders = np.arange(len(gaussians))  # of each Gaussian the first of its cell
    for size in np.unique(sizes[sizes > 1]).tolist():
        v, y, x = (k[:, None, None] for k in np.nonzero(sizes[:, ::size, ::size] == size))
        steps = np.arange(size)
        members = rows[v, size * y + steps[:, None], size * x + steps]
        first = members[:, 0, 0]
        leaders[members] = first[:, None, None]
        for name in ("means", "opacities", "sh"):
            arrays_out[name][first] = arrays[name][members].mean((1, 2), dtype=np.float64)
        if "guessed" in arrays:
            arrays_out["guessed"][first] = arrays["guessed"][members].mean((1, 2)) > 0.5
        arrays_out["scales"][first] = _scales(arrays, members)
    is_leader = leaders == np.arange(len(gaussians))
    merged = gaussians.with_arrays(**arrays_out)[is_leader]
    return merged, (np.cumsum(is_leader) - 1)[leaders]


def _scales(arrays: Mapping[str, np.ndarray], members: np.ndarray) -> np.ndarray:
    """Compute scales [K, 3] of cells [K, s, s], along the axes of their first members.

    A view draws a Gaussian widened by the low-pass filter. The drawn width of a merged Gaussian is
    scaled with the side of its cell, so that the surface stays closed: with C the mean covariance
    of its members, s the side and u, v the steps to the next pixel on the surface, its covariance
    is ``s^2 C + (s^2 - 1) LOW_PASS (u u^T + v v^T)``.
    """

    def axes(rows: np.ndarray) -> np.ndarray:
        turns = Rotation.from_quat(arrays["quats"][rows], scalar_first=True).as_matrix()
        return turns.reshape(-1, 3, 3)

    size, half = members.shape[1], members.shape[1] // 2
    first = axes(members[:, 0, 0])
    variances = np.zeros((len(members), 3))
    for rows in members.reshape(len(members), size * size).T:
        along = np.einsum("kia,kij->kaj", first, axes(rows)) * arrays["scales"][rows][:, None]
        variances += np.square(along).sum(-1)
    means = arrays["means"][members].astype(np.float64)
    for lower, upper in (
        (means[:, :, :half], means[:, :, half:]),
        (means[:, :half], means[:, half:]),
    ):
        step = (upper.mean((1, 2)) - lower.mean((1, 2))) / half
        variances += LOW_PASS * (size**2 - 1) * np.einsum("kia,ki->ka", first, step) ** 2
    return np.sqrt(variances)
