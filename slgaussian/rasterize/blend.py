"""Compositing of splats into pixels, tile by tile, and back-propagation to the splats."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vany, vexp2, vload, vstore, vsum, vwhere, vzero
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.project import MOMENTS
from slgaussian.rasterize.tiles import (
    BLOCK,
    LANE_COLUMNS,
    LANE_ROWS,
    STRIP_TILES,
    TILE_BLOCKS,
    TILE_HEIGHT,
    Bins,
    count_strips,
    find_corner,
    load_tile,
    make_workspace,
    tile_range,
)

OPAQUE_TEST_INTERVAL = 8
"""Splats composited between two tests whether all pixels of a block are opaque."""


class SplatScene(NamedTuple):
    """Splats of an image, as the first arguments of kernels.

    Attributes:
        splats, boxes: As :func:`slgaussian.rasterize.project.project` returns them.
        values: float32 [N, C]
        alpha_max, pass_min: float32. See :class:`slgaussian.rasterize.render_settings.Settings`.
    """

    splats: np.ndarray
    boxes: np.ndarray
    values: np.ndarray
    bins: Bins
    alpha_max: np.float32
    pass_min: np.float32


def draw(scene: SplatScene, width: int, height: int, with_median: bool) -> tuple[np.ndarray, ...]:
    """Composite front to back.

    Returns:
        image: float32 [H, W, C]
        alpha: float32 [H, W]
        depth: float32 [H, W]. Mean z; 0 where alpha is 0.
        median: float32 [H, W], or [0, 0] without ``with_median``
    """
    image = np.empty((height, width, scene.values.shape[1]), np.float32)
    alpha = np.empty((height, width), np.float32)
    depth = np.zeros((height, width), np.float32)
    median = np.zeros((height, width) if with_median else (0, 0), np.float32)
    share(_draw, count_strips(scene.bins), *scene, image, alpha, depth, median)
    return image, alpha, depth, median


@kernel
def _draw(counter, splats, boxes, values, bins, alpha_max, pass_min, image, alpha, depth, median):
    height, width, channels = image.shape
    channels += 1
    with_median = median.size > 0
    strip, tiles = take(counter), bins.across * bins.down
    work = make_workspace(bins, channels - 1)
    # A lane holds one pixel of a block of 4x4. Channel c of all pixels is at sums[c LANES]; z is
    # the last channel, and up to three more are computed along with it and dropped.
    sums = np.empty((channels + 3) * LANES, np.float32)
    alphas, middles = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    while strip * STRIP_TILES < tiles:
        for tile in range(strip * STRIP_TILES, min(tiles, (strip + 1) * STRIP_TILES)):
            left, top = load_tile(tile, bins, splats, boxes, values, work)
            for block in range(TILE_BLOCKS):
                x0, y0 = find_corner(block, left, top)
                if x0 >= width or y0 >= height:
                    continue
                used, _, block_alphas = blend_weights(block, work, alpha_max, pass_min)
                vstore(alphas, 0, block_alphas)
                _sum_block(block, used, channels, work, sums)
                if with_median:
                    vstore(middles, 0, _median_block(block, used, channels, work))
                for y in range(y0, min(y0 + BLOCK, height)):
                    for x in range(x0, min(x0 + BLOCK, width)):
                        lane = (y - y0) * BLOCK + x - x0
                        for c in range(channels - 1):
                            image[y, x, c] = sums[c * LANES + lane]
                        # Rounding may take a sum of weights above 1.
                        alpha[y, x] = min(alphas[lane], np.float32(1))
                        if alphas[lane] > 0:
                            depth[y, x] = sums[(channels - 1) * LANES + lane] / alphas[lane]
                        if with_median:
                            median[y, x] = middles[lane]
        strip = take(counter)


def draw_backward(
    scene: SplatScene, firsts: np.ndarray, d_image: np.ndarray, d_alpha: np.ndarray, d_z: np.ndarray
) -> np.ndarray:
    """Compute the gradients of the splats, one row for each tile that they touch.

    The weights are recomputed; then each block is processed back to front. With R the composite of
    everything behind a splat, ``dL/dalpha = T (f - R)``, where T is the transmittance before the
    splat and f its values, all times the upstream gradient. T is the transmittance after the splat
    plus its weight, which avoids dividing by 1 - alpha, so opaque splats need no special case.

    Args:
        firsts: int64 [N + 1]. See :func:`slgaussian.rasterize.project.project_backward`.
        d_image, d_alpha, d_z: float32 [H, W, C], [H, W], [H, W]. Upstream gradients; the last of
            the composited, not the mean, z.

    Returns:
        float32 [firsts[N], MOMENTS + C + 1]
    """
    grads = np.empty((firsts[-1], MOMENTS + scene.values.shape[1] + 1), np.float32)
    share(_draw_backward, count_strips(scene.bins), *scene, firsts, d_image, d_alpha, d_z, grads)
    return grads


@kernel
def _draw_backward(
    counter, splats, boxes, values, bins, alpha_max, pass_min, firsts, d_image, d_alpha, d_z, grads
):
    height, width, channels = d_image.shape
    channels += 1
    sums = MOMENTS + channels
    strip, tiles = take(counter), bins.across * bins.down
    work = make_workspace(bins, channels - 1)
    # Sums of each splat stay apart by lane until the tile is done: one sum over lanes for each, not
    # one for each block. A row of a splat and a tile is written by one thread only, so no atomics.
    totals = np.empty(len(work.keys) * sums * LANES, np.float32)
    upstream = np.empty((channels + 1) * LANES, np.float32)
    while strip * STRIP_TILES < tiles:
        for tile in range(strip * STRIP_TILES, min(tiles, (strip + 1) * STRIP_TILES)):
            left, top = load_tile(tile, bins, splats, boxes, values, work)
            start = bins.starts[tile]
            n = bins.starts[tile + 1] - start
            totals[: n * sums * LANES] = 0
            for block in range(TILE_BLOCKS):
                x0, y0 = find_corner(block, left, top)
                if x0 >= width or y0 >= height:
                    continue
                used, transmittance, _ = blend_weights(block, work, alpha_max, pass_min)
                upstream[:] = 0  # lanes beyond the border of the image count for nothing
                for y in range(y0, min(y0 + BLOCK, height)):
                    for x in range(x0, min(x0 + BLOCK, width)):
                        lane = (y - y0) * BLOCK + x - x0
                        for c in range(channels - 1):
                            upstream[c * LANES + lane] = d_image[y, x, c]
                        upstream[(channels - 1) * LANES + lane] = d_z[y, x]
                        # The background has alpha 0: it is composited with gradient -d_alpha.
                        upstream[channels * LANES + lane] = -d_alpha[y, x]
                _block_backward(
                    block, used, channels, work, upstream, transmittance, alpha_max, totals
                )
            for k in range(n):
                i = bins.entries[start + k]
                x0, x1, y0, _ = tile_range(boxes[i])
                # Tiles of a splat have consecutive rows, in row-major order within its range.
                row = firsts[i] + (tile // bins.across - y0) * (x1 - x0)
                row += tile % bins.across - x0
                for m in range(sums):
                    grads[row, m] = vsum(vload(totals, (k * sums + m) * LANES))
        strip = take(counter)


@kernel(inline="always")
def blend_weights(block, work, alpha_max, pass_min):
    """Write the weights of one block of a loaded tile, a vector for each splat of its list.

    Returns the number of processed splats, the remaining transmittance, and the sum of the weights,
    which is alpha with full precision for small values.
    """
    # A lane holds one pixel. Front to back (paper, eq. 2; Kerbl et al. 2023, eq. 3): the weight is
    # alpha T, and T (1 - alpha) is T less that weight, so that weights and what is let through sum
    # to one. The sum of the weights is kept as well: 1 - T has no digits left where alpha is small.
    first = block * len(work.keys)
    left, top = _corner(block)
    zero = vzero()
    accumulated, transmittance = zero, zero + np.float32(1)
    # With pass_min 0, too, a pixel is finished once nothing at all is let through.
    finished = max(pass_min, np.float32(1e-30))
    j, count = 0, work.counts[block]
    while j < count and vany(transmittance >= finished):
        for now in range(j, min(j + OPAQUE_TEST_INTERVAL, count)):
            local = work.local[np.uint32(work.lists[first + now])]
            # A cut is a mask, not a branch: other lanes go on.
            e, d = _offsets(left, top, local)
            power = local.power - e * e - d * d
            alpha = vexp2(power)
            alpha = vwhere(alpha < alpha_max, alpha, alpha_max)
            drawn = (power >= local.cut) & (transmittance >= finished)
            weight = vwhere(drawn, alpha * transmittance, np.float32(0))
            vstore(work.weights, now * LANES, weight)
            transmittance = transmittance - weight
            accumulated = accumulated + weight
        j = min(j + OPAQUE_TEST_INTERVAL, count)
    return j, transmittance, accumulated


@kernel(inline="always")
def _corner(block):
    """Return the first pixel of a block relative to the first of its tile's middle row."""
    left, top = find_corner(block, 0, -(TILE_HEIGHT // 2))
    return np.float32(left), np.float32(top)


@kernel(inline="always")
def _offsets(left, top, local):
    """Return distances e and d of pixels: horizontal, from the splat's axis in their row, and
    vertical, from its centre, in units in which the Gaussian is ``2^-(e^2 + d^2)``.
    """
    # Linear in column and row: two vectors of constants, and scalars that are computed once a
    # block. The difference of centres is taken first, as both are large where a splat is far away.
    e = vload(LANE_COLUMNS, 0) * local.root + (local.root * (left - local.x) - local.slant * top)
    d = vload(LANE_ROWS, 0) * local.row_root + local.row_root * (top - local.y)
    return e - vload(LANE_ROWS, 0) * local.slant, d


@kernel(inline="always")
def _sum_block(block, used, channels, work, sums):
    """Compute weighted sums of the values of the splats of a list, a vector for each channel."""
    first = block * len(work.keys)
    zero = vzero()
    # Four channels at a time: each weight is loaded once for four independent sums. Sums past the
    # last channel have values of the next splat, and are not used.
    for c in range(0, channels, 4):
        a, b, d, e = zero, zero, zero, zero
        for j in range(used):
            weight = vload(work.weights, j * LANES)
            at = np.uint32(work.lists[first + j]) * channels + c
            a = a + weight * work.carried[at]
            b = b + weight * work.carried[at + 1]
            d = d + weight * work.carried[at + 2]
            e = e + weight * work.carried[at + 3]
        vstore(sums, c * LANES, a)
        vstore(sums, (c + 1) * LANES, b)
        vstore(sums, (c + 2) * LANES, d)
        vstore(sums, (c + 3) * LANES, e)


@kernel(inline="always")
def _median_block(block, used, channels, work):
    """Return the z of the splat at which transmittance reaches one half; 0 where it does not."""
    first = block * len(work.keys)
    median = vzero()
    transmittance = median + np.float32(1)
    for j in range(used):
        remaining = transmittance - vload(work.weights, j * LANES)
        k = np.uint32(work.lists[first + j])
        z = work.carried[k * channels + channels - 1]
        reached = (transmittance > np.float32(0.5)) & (remaining <= np.float32(0.5))
        median = vwhere(reached, z, median)
        transmittance = remaining
    return median


@kernel
def _block_backward(block, used, channels, work, upstream, transmittance, alpha_max, totals):
    # Back to front. With s the upstream gradients, f s of a splat is ``value``, and ``behind`` is R
    # s, the composite of all that lies behind: R = alpha f + (1 - alpha) R from one splat to the
    # next in front, so R += alpha (f - R). All channels, z and alpha share it, as the loss is
    # linear in each.
    first = block * len(work.keys)
    sums = MOMENTS + channels
    # A clamped alpha has zero gradient. weight / transmittance is alpha only up to rounding,
    # hence the tolerance.
    free = alpha_max * np.float32(1 - 1e-6) if alpha_max < 1 else np.float32(2)
    behind = vload(upstream, channels * LANES)
    left, top = _corner(block)
    zero = vzero()
    for j in range(used - 1, -1, -1):
        k = np.uint32(work.lists[first + j])
        weight = vload(work.weights, j * LANES)
        transmittance = transmittance + weight
        alpha = vwhere(weight > np.float32(0), weight / transmittance, np.float32(0))
        value = zero
        at = k * channels
        to = (k * sums + MOMENTS) * LANES
        for c in range(channels):
            slope = vload(upstream, c * LANES)
            value = value + slope * work.carried[at + c]
            vstore(totals, to, vload(totals, to) + weight * slope)
            to += LANES
        # dL/dalpha = T (f - R) s, so that h = alpha dL/dalpha is weight (f - R) s.
        ahead = value - behind
        h = vwhere(alpha < free, weight * ahead, np.float32(0))
        behind = behind + alpha * ahead
        # The moments of h over the splat's pixels, from which project_backward has the rest: e and
        # d are linear in the pixel, so that six sums stand for all gradients of the Gaussian's
        # shape.
        e, d = _offsets(left, top, work.local[k])
        he = h * e
        to = k * sums * LANES
        vstore(totals, to, vload(totals, to) + h)
        vstore(totals, to + LANES, vload(totals, to + LANES) + he)
        vstore(totals, to + 2 * LANES, vload(totals, to + 2 * LANES) + he * e)
        vstore(totals, to + 3 * LANES, vload(totals, to + 3 * LANES) + h * d)
        vstore(totals, to + 4 * LANES, vload(totals, to + 4 * LANES) + he * d)
        vstore(totals, to + 5 * LANES, vload(totals, to + 5 * LANES) + h * (d * d))
