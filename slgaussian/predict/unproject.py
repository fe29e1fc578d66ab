"""Unprojection of depth maps: one thin disc for each pixel, aligned with the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.kernels.jit import kernel
from slgaussian.scene import Camera

FOOTPRINT = 0.35
"""Standard deviation of a disc across the line of sight, in pixels of its own view. With the
rasterizer's low-pass filter surfaces have no holes, even from half the distance. Larger discs blur:
0.45 costs 0.1 dB in novel views, 0.6 half a decibel."""

THICKNESS = 0.1
"""Standard deviation along the normal, as a share of that across the line of sight."""

MIN_COSINE = 0.25
"""Smallest cosine between normal and line of sight by which discs are elongated."""

SLOPE_RADIUS = 3
SAME_SURFACE = 0.03
"""Half the window from which a normal is estimated, pixels, and the largest relative difference of
inverse depth within it."""


def unproject(
    cameras: Sequence[Camera],
    colours: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    opacities: Sequence[np.ndarray],
) -> Gaussians:
    """Convert depth maps to one Gaussian for each pixel, in the order of ``source``.

    Args:
        cameras: V Camera of one size
        colours: V of float32 [H, W, 3]. RGB in [0, 1].
        inverse_depths: V of float32 [H, W]. 1 / z, positive and finite.
        opacities: V of float32 [H, W]

    Returns:
        Gaussians: V * H * W of them in world space, spherical harmonics of degree 0.
    """
    parts = [_make_discs(*view) for view in zip(cameras, inverse_depths, strict=True)]
    means, scales, quats = (np.concatenate(p) for p in zip(*parts, strict=True))
    rgb = np.concatenate([c.reshape(-1, 3) for c in colours])
    return Gaussians.from_arrays(
        {
            "means": means,
            "scales": scales,
            "quats": quats,
            "opacities": np.concatenate([o.ravel() for o in opacities]),
            "sh": rgb_to_sh(rgb),
            "source": np.arange(len(means), dtype=np.int32),
        }
    )


def _make_discs(camera: Camera, inverse_depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Means [H * W, 3], scales [H * W, 3] and quaternions wxyz [H * W, 4], float32, world space.

    Local axes of a disc: across the line of sight, along the slope, and the normal.
    """
    depth, R = 1 / inverse_depth.ravel().astype(np.float64), camera.c2w[:3, :3]
    n = np.ascontiguousarray(normals(inverse_depth, camera.K).reshape(-1, 3).T)
    row, column = np.indices(inverse_depth.shape).reshape(2, -1) + 0.5
    rays = _rotate(np.linalg.inv(camera.K), np.stack([column, row, np.ones(len(depth))]))
    means = camera.center[:, None] + depth * _rotate(R, rays)
    rays /= _length(rays)
    across = np.cross(n, rays, axis=0)
    # Where the surface faces the camera any axis in its plane will do.
    facing = _length(across) < 1e-6
    across[:, facing] = np.cross(n[:, facing], [[0.0], [1.0], [0.0]], axis=0)
    across /= _length(across)
    axes = np.stack([_rotate(R, axis) for axis in (across, np.cross(n, across, axis=0), n)], 1)
    cosine = np.where(facing, 1.0, np.abs((n * rays).sum(0)))
    width = FOOTPRINT / np.sqrt(camera.K[0, 0] * camera.K[1, 1]) * depth
    scales = np.stack([width, width / np.maximum(cosine, MIN_COSINE), width * THICKNESS])
    quats = _quaternions(axes)
    parts = means, scales, quats / _length(quats)
    return tuple(part.T.astype(np.float32, order="C") for part in parts)


def _rotate(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Multiply a matrix by vectors [3, N], without BLAS: bitwise equal on any CPU."""
    x, y, z = vectors
    return R[:, :1] * x + R[:, 1:2] * y + R[:, 2:] * z


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors * vectors).sum(0))


def _quaternions(R: np.ndarray) -> np.ndarray:
    """Return quaternions wxyz [4, N] of rotations [3, 3, N], times 4 times their largest component
    (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    table = np.empty((4, 4, R.shape[2]))
    table[0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        table[0, 1 + i] = table[1 + i, 0] = R[k, j] - R[j, k]
        table[1 + i, 1 + i] = 1 + 2 * R[i, i] - trace
        table[1 + j, 1 + i] = table[1 + i, 1 + j] = R[j, i] + R[i, j]
    largest = np.argmax([R[0, 0], R[1, 1], R[2, 2], trace], 0)
    return np.take_along_axis(table, (largest + 1)[None, None] % 4, 0)[0]


def normals(inverse_depth: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Estimate unit normals in camera coordinates, facing the camera, float64 [H, W, 3].

    A plane ``n . X = 1`` has inverse depth ``w = (K^-T n) . (u, v, 1)``: linear in the pixel, so
    its normal follows from the slope of ``w``, fitted to the pixels nearby on the same surface.
    """
    return _normals(inverse_depth, np.ascontiguousarray(K), SLOPE_RADIUS, SAME_SURFACE)


@kernel
def _normals(values, K, radius, same):
    """Compute normals from least-squares slopes over window pixels of the same surface."""
    H, W = values.shape
    out = np.empty((H, W, 3))
    for y in range(H):
        for x in range(W):
            centre = values[y, x]
            n = sx = sy = sw = sxx = sxy = syy = sxw = syw = 0.0
            for j in range(max(y - radius, 0), min(y + radius + 1, H)):
                for i in range(max(x - radius, 0), min(x + radius + 1, W)):
                    w = values[j, i] - centre
                    if abs(w) <= same * centre:
                        dx, dy = float(i - x), float(j - y)
                        n += 1
                        sx += dx
                        sy += dy
                        sw += w
                        sxx += dx * dx
                        sxy += dx * dy
                        syy += dy * dy
                        sxw += dx * w
                        syw += dy * w
            # Centred moments; a window that is a point or a line has no normal.
            a, b, c = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            p, q = sxw - sx * sw / n, syw - sy * sw / n
            det = a * c - b * b
            du = dv = 0.0
            if n >= 6 and det > 1e-3 * n * n:
                du, dv = (c * p - b * q) / det, (a * q - b * p) / det
            rest = centre - (x + 0.5) * du - (y + 0.5) * dv
            along = du * K[0, 0] + dv * K[1, 0] + rest * K[2, 0]
            down = du * K[0, 1] + dv * K[1, 1] + rest * K[2, 1]
            offset = du * K[0, 2] + dv * K[1, 2] + rest * K[2, 2]
            length = math.sqrt(along * along + down * down + offset * offset)
            out[y, x, 0] = -along / length
            out[y, x, 1] = -down / length
            out[y, x, 2] = -offset / length
    return out
