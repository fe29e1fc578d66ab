"""A naive rasterisation loop, the baseline of the rasteriser's speed.

It projects every Gaussian, sorts them by depth, and splats them in order into the image, with two
threads for half of the rows each. The cut-offs are the usual ones: 3 sigma, alpha 1/255, and
transmittance 1e-4.
"""

import math

# Set before the import of Numba, which reads its cache folder once.
import slgaussian.kernels.threads  # noqa: F401

# isort: split
import numba
import numpy as np


def splat_in_order(arrays, values, camera):
    """Render float32 [H, W, C] from the arrays of ``Gaussians.to_arrays``."""
    splats = _project(
        arrays["means"],
        arrays["scales"],
        arrays["quats"],
        arrays["opacities"],
        camera.w2c.astype(np.float32),
        camera.K.astype(np.float32),
    )
    order = np.argsort(splats[:, 6], kind="stable")
    return _splat(splats, order, values, camera.width, camera.height)


@numba.njit(cache=True, parallel=True, fastmath=True)
def _project(means, scales, quats, opacities, w2c, K):
    splats = np.zeros((len(means), 8), np.float32)
    fx, fy = K[0, 0], K[1, 1]
    for i in numba.prange(len(means)):
        mx, my, mz = means[i]
        z = w2c[2, 0] * mx + w2c[2, 1] * my + w2c[2, 2] * mz + w2c[2, 3]
        splats[i, 6] = z
        if z <= 0.01:
            continue
        x = (w2c[0, 0] * mx + w2c[0, 1] * my + w2c[0, 2] * mz + w2c[0, 3]) / z
        y = (w2c[1, 0] * mx + w2c[1, 1] * my + w2c[1, 2] * mz + w2c[1, 3]) / z
        qw, qx, qy, qz = quats[i]
        axes = (
            (1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz), 2 * (qx * qz - qw * qy)),
            (2 * (qx * qy - qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz + qw * qx)),
            (2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx * qx + qy * qy)),
        )
        xx = yy = np.float32(0.3)
        xy = np.float32(0.0)
        for k in range(3):
            ax, ay, az = axes[k]
            lx = w2c[0, 0] * ax + w2c[0, 1] * ay + w2c[0, 2] * az
            ly = w2c[1, 0] * ax + w2c[1, 1] * ay + w2c[1, 2] * az
            lz = w2c[2, 0] * ax + w2c[2, 1] * ay + w2c[2, 2] * az
            px = fx * scales[i, k] / z * (lx - x * lz)
            py = fy * scales[i, k] / z * (ly - y * lz)
            xx += px * px
            xy += px * py
            yy += py * py
        det = xx * yy - xy * xy
        splats[i, 0] = fx * x + K[0, 2]
        splats[i, 1] = fy * y + K[1, 2]
        splats[i, 2], splats[i, 3], splats[i, 4] = yy / det, -xy / det, xx / det
        splats[i, 5] = opacities[i]
        splats[i, 7] = 3 * math.sqrt(max(xx, yy))
    return splats


@numba.njit(cache=True, parallel=True, fastmath=True)
def _splat(splats, order, values, width, height):
    channels = values.shape[1]
    image = np.zeros((height, width, channels), np.float32)
    light = np.ones((height, width), np.float32)
    for band in numba.prange(2):
        top, bottom = band * height // 2, (band + 1) * height // 2
        for i in order:
            u, v, a, b, c, opacity, z, r = splats[i]
            if z <= 0.01 or v + r < top or v - r > bottom or u + r < 0 or u - r > width:
                continue
            for y in range(max(top, int(v - r)), min(bottom, int(v + r) + 1)):
                dy = y + np.float32(0.5) - v
                for x in range(max(0, int(u - r)), min(width, int(u + r) + 1)):
                    if light[y, x] < 1e-4:
                        continue
                    dx = x + np.float32(0.5) - u
                    power = np.float32(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy
                    alpha = opacity * math.exp(power)
                    if alpha < 1 / 255:
                        continue
                    for k in range(channels):
                        image[y, x, k] += alpha * light[y, x] * values[i, k]
                    light[y, x] *= 1 - alpha
    return image
