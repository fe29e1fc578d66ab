"""The fast rasteriser: Numba, parallel over tiles, float32 accumulators.

Gaussians are sorted once by depth and appended in that order to the list of every tile they touch,
so each list is sorted by itself and equal depths keep the order of the input. A tile then draws its
list splat by splat: pixel-aligned Gaussians cover a few pixels each, and walking their few pixels
beats asking every pixel about every Gaussian. What a tile computes does not depend on the thread
that runs it, so the bytes do not depend on the thread count.
"""

import math

import numba
import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.rasterize.api import FRUSTUM_MARGIN, LOW_PASS, NEAR_PLANE, Render
from slgaussian.scene import Camera

TILE = 16
ALPHA_MIN = 1 / 4096
"""A splat is cut where its own alpha falls below this: a sixteenth of a grey level."""
PASS_MIN = 1e-4
"""A pixel is finished once it lets less light than this through."""


def render(gaussians: Gaussians, values: torch.Tensor, camera: Camera) -> Render:
    """See :func:`slgaussian.rasterize.rasterize`; results are float32."""
    arrays = gaussians.to_arrays()
    carried = np.ascontiguousarray(values.detach().cpu().numpy(), np.float32)
    splats, boxes = _project(
        arrays["means"].astype(np.float32),
        arrays["scales"].astype(np.float32),
        arrays["quats"].astype(np.float32),
        arrays["opacities"].astype(np.float32),
        camera.w2c,
        camera.K,
        camera.width,
        camera.height,
    )
    visible = np.flatnonzero(boxes[:, 1] > boxes[:, 0])
    order = visible[np.argsort(splats[visible, 6], kind="stable")]
    tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    starts, entries = _tile_lists(order, boxes, tiles_x, tiles_y)
    image, alpha, depth = _draw(
        splats, boxes, carried, starts, entries, tiles_x, camera.width, camera.height
    )
    return Render(torch.from_numpy(image), torch.from_numpy(alpha), torch.from_numpy(depth))


@numba.njit(cache=True, parallel=True)
def _project(means, scales, quats, opacities, w2c, K, width, height):
    """Project every Gaussian, in float64.

    Returns splats float32 [N, 7] (u, v, the upper triangle xx, xy, yy of the inverse covariance,
    opacity, z) and boxes int32 [N, 4] (x0, x1, y0, y1, half-open; x1 <= x0 means invisible).
    """
    n = means.shape[0]
    splats = np.zeros((n, 7), np.float32)
    boxes = np.zeros((n, 4), np.int32)
    fx, skew, cx, fy, cy = K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2]
    margin_x = FRUSTUM_MARGIN * width / (2 * fx)
    margin_y = FRUSTUM_MARGIN * height / (2 * fy)
    for i in numba.prange(n):
        opacity = opacities[i]
        if opacity < ALPHA_MIN:
            continue
        mx, my, mz = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
        z = w2c[2, 0] * mx + w2c[2, 1] * my + w2c[2, 2] * mz + w2c[2, 3]
        if not z > NEAR_PLANE:
            continue
        x = (w2c[0, 0] * mx + w2c[0, 1] * my + w2c[0, 2] * mz + w2c[0, 3]) / z
        y = (w2c[1, 0] * mx + w2c[1, 1] * my + w2c[1, 2] * mz + w2c[1, 3]) / z
        u = fx * x + skew * y + cx
        v = fy * y + cy

        tx = min(max(x, -cx / fx - margin_x), (width - cx) / fx + margin_x)
        ty = min(max(y, -cy / fy - margin_y), (height - cy) / fy + margin_y)
        qw, qx, qy, qz = (
            float(quats[i, 0]),
            float(quats[i, 1]),
            float(quats[i, 2]),
            float(quats[i, 3]),
        )
        norm = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        qw, qx, qy, qz = qw / norm, qx / norm, qy / norm, qz / norm
        xx = xy = yy = 0.0
        # The projected covariance is a sum over the three axes of the outer product of each
        # axis, scaled and projected: no 3x3 matrix is needed.
        for axis in range(3):
            if axis == 0:
                ax, ay, az = (
                    1 - 2 * (qy * qy + qz * qz),
                    2 * (qx * qy + qw * qz),
                    2 * (qx * qz - qw * qy),
                )
            elif axis == 1:
                ax, ay, az = (
                    2 * (qx * qy - qw * qz),
                    1 - 2 * (qx * qx + qz * qz),
                    2 * (qy * qz + qw * qx),
                )
            else:
                ax, ay, az = (
                    2 * (qx * qz + qw * qy),
                    2 * (qy * qz - qw * qx),
                    1 - 2 * (qx * qx + qy * qy),
                )
            s = float(scales[i, axis]) / z
            lx = s * (w2c[0, 0] * ax + w2c[0, 1] * ay + w2c[0, 2] * az)
            ly = s * (w2c[1, 0] * ax + w2c[1, 1] * ay + w2c[1, 2] * az)
            lz = s * (w2c[2, 0] * ax + w2c[2, 1] * ay + w2c[2, 2] * az)
            px = fx * (lx - tx * lz) + skew * (ly - ty * lz)
            py = fy * (ly - ty * lz)
            xx += px * px
            xy += px * py
            yy += py * py
        # det(P + lI) = det(P) + l tr(P) + l^2, with det(P) kept non-negative against rounding.
        det = max(xx * yy - xy * xy, 0.0) + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
        xx += LOW_PASS
        yy += LOW_PASS
        reach = math.sqrt(2 * math.log(opacity / ALPHA_MIN))
        rx, ry = reach * math.sqrt(xx), reach * math.sqrt(yy)
        if u + rx <= 0 or u - rx >= width or v + ry <= 0 or v - ry >= height:
            continue
        boxes[i, 0] = max(0, math.ceil(u - rx - 0.5))
        boxes[i, 1] = min(width, math.floor(u + rx - 0.5) + 1)
        boxes[i, 2] = max(0, math.ceil(v - ry - 0.5))
        boxes[i, 3] = min(height, math.floor(v + ry - 0.5) + 1)
        if boxes[i, 3] <= boxes[i, 2]:
            boxes[i, 1] = boxes[i, 0]
        splats[i, 0], splats[i, 1] = u, v
        splats[i, 2], splats[i, 3], splats[i, 4] = yy / det, -xy / det, xx / det
        splats[i, 5], splats[i, 6] = opacity, z
    return splats, boxes


@numba.njit(cache=True)
def _tile_lists(order, boxes, tiles_x, tiles_y):
    """The Gaussians of every tile, front to back: entries[starts[t]:starts[t + 1]]."""
    starts = np.zeros(tiles_x * tiles_y + 1, np.int64)
    for i in order:
        for ty in range(boxes[i, 2] // TILE, (boxes[i, 3] - 1) // TILE + 1):
            for tx in range(boxes[i, 0] // TILE, (boxes[i, 1] - 1) // TILE + 1):
                starts[ty * tiles_x + tx + 1] += 1
    starts = np.cumsum(starts)
    cursor = starts[:-1].copy()
    entries = np.empty(starts[-1], np.int32)
    for i in order:
        for ty in range(boxes[i, 2] // TILE, (boxes[i, 3] - 1) // TILE + 1):
            for tx in range(boxes[i, 0] // TILE, (boxes[i, 1] - 1) // TILE + 1):
                entries[cursor[ty * tiles_x + tx]] = i
                cursor[ty * tiles_x + tx] += 1
    return starts, entries


@numba.njit(cache=True, parallel=True)
def _draw(splats, boxes, values, starts, entries, tiles_x, width, height):
    """Composite every tile front to back: image [H, W, C], alpha [H, W], depth [H, W]."""
    channels = values.shape[1]
    image = np.zeros((height, width, channels), np.float32)
    passed = np.ones((height, width), np.float32)
    depth = np.zeros((height, width), np.float32)
    for tile in numba.prange(len(starts) - 1):
        left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        right, bottom = min(left + TILE, width), min(top + TILE, height)
        unfinished = (right - left) * (bottom - top)
        for entry in range(starts[tile], starts[tile + 1]):
            if unfinished == 0:
                break
            i = entries[entry]
            u, v, a, b, c, opacity, z = splats[i]
            floor = math.log(ALPHA_MIN / opacity)
            for row in range(max(top, boxes[i, 2]), min(bottom, boxes[i, 3])):
                dy = np.float32(row + 0.5) - v
                for column in range(max(left, boxes[i, 0]), min(right, boxes[i, 1])):
                    light = passed[row, column]
                    if light < PASS_MIN:
                        continue
                    dx = np.float32(column + 0.5) - u
                    power = np.float32(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy
                    if power < floor:
                        continue
                    alpha = opacity * math.exp(min(power, np.float32(0.0)))
                    weight = alpha * light
                    for k in range(channels):
                        image[row, column, k] += weight * values[i, k]
                    depth[row, column] += weight * z
                    left_over = light * (1 - alpha)
                    passed[row, column] = left_over
                    if left_over < PASS_MIN:
                        unfinished -= 1
    alpha_total = 1 - passed
    for row in numba.prange(height):
        for column in range(width):
            if alpha_total[row, column] > 0:
                depth[row, column] /= alpha_total[row, column]
    return image, alpha_total, depth
