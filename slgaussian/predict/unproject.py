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
    colors: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    opacities: Sequence[np.ndarray],
) -> Gaussians:
    """Convert depth maps to one Gaussian for each pixel, in the order of ``source``.

    Args:
        cameras: V Camera of one size
        colors: V of float32 [H, W, 3]. RGB in [0, 1].
        inverse_depths: V of float32 [H, W]. 1 / z, positive and finite.
        opacities: V of float32 [H, W]

    Returns:
        Gaussians: V * H * W of them in world space, spherical harmonics of degree 0.
    """
    parts = [_discs_of(*view) for view in zip(cameras, inverse_depths, strict=True)]
    means, scales, quats = (np.concatenate(p) for p in zip(*parts, strict=True))
    rgb = np.concatenate([c.reshape(-1, 3) for c in colors])
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


def _discs_of(camera: Camera, inverse_depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Means [H * W, 3], scales [H * W, 3] and quaternions wxyz [H * W, 4], float32, world space."""
    return _discs(
        inverse_depth,
        normals(inverse_depth, camera.K),
        np.linalg.inv(camera.K),
        np.ascontiguousarray(camera.c2w[:3, :3]),
        np.ascontiguousarray(camera.center),
        FOOTPRINT / np.sqrt(camera.K[0, 0] * camera.K[1, 1]),
    )


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
            away = du * K[0, 2] + dv * K[1, 2] + rest * K[2, 2]
            length = math.sqrt(along * along + down * down + away * away)
            out[y, x, 0] = -along / length
            out[y, x, 1] = -down / length
            out[y, x, 2] = -away / length
    return out


# Scalars instead of slices: assignments to slices take seconds to compile, for their shape errors.


@kernel
def _discs(inverse_depth, normal, K_inverse, R, center, footprint):
    """Compute discs with the local axes (across the line of sight, along the slope, normal)."""
    H, W = inverse_depth.shape
    means = np.empty((H * W, 3), np.float32)
    scales = np.empty((H * W, 3), np.float32)
    quats = np.empty((H * W, 4), np.float32)
    for y in range(H):
        turned = np.empty((3, 3))
        q = np.empty(4)
        for x in range(W):
            k = y * W + x
            depth = 1 / float(inverse_depth[y, x])
            s0 = K_inverse[0, 0] * (x + 0.5) + K_inverse[0, 1] * (y + 0.5) + K_inverse[0, 2]
            s1 = K_inverse[1, 0] * (x + 0.5) + K_inverse[1, 1] * (y + 0.5) + K_inverse[1, 2]
            s2 = K_inverse[2, 0] * (x + 0.5) + K_inverse[2, 1] * (y + 0.5) + K_inverse[2, 2]
            for i in range(3):
                means[k, i] = center[i] + depth * (R[i, 0] * s0 + R[i, 1] * s1 + R[i, 2] * s2)
            length = math.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
            s0, s1, s2 = s0 / length, s1 / length, s2 / length
            n0, n1, n2 = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            a0, a1, a2, tilt = _cross(n0, n1, n2, s0, s1, s2)
            if tilt < 1e-6:
                # The surface faces the camera: any axis in the plane will do.
                a0, a1, a2, tilt = _cross(n0, n1, n2, 0.0, 1.0, 0.0)
                s0, s1, s2 = -n0, -n1, -n2
            a0, a1, a2 = a0 / tilt, a1 / tilt, a2 / tilt
            b0, b1, b2, _ = _cross(n0, n1, n2, a0, a1, a2)
            for i in range(3):
                turned[i, 0] = R[i, 0] * a0 + R[i, 1] * a1 + R[i, 2] * a2
                turned[i, 1] = R[i, 0] * b0 + R[i, 1] * b1 + R[i, 2] * b2
                turned[i, 2] = R[i, 0] * n0 + R[i, 1] * n1 + R[i, 2] * n2
            cosine = abs(n0 * s0 + n1 * s1 + n2 * s2)
            width = footprint * depth
            scales[k, 0] = width
            scales[k, 1] = width / max(cosine, MIN_COSINE)
            scales[k, 2] = width * THICKNESS
            _quaternion(turned, q)
            length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
            for i in range(4):
                quats[k, i] = q[i] / length
    return means, scales, quats


@kernel
def _cross(a0, a1, a2, b0, b1, b2):
    """Return ``a x b`` and its length."""
    x, y, z = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return x, y, z, math.sqrt(x * x + y * y + z * z)


@kernel
def _quaternion(R, q):
    """Write an unnormalised quaternion wxyz of a rotation, by its largest component (Shepperd
    1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > max(R[0, 0], R[1, 1], R[2, 2]):
        q[0] = 1 + trace
        q[1] = R[2, 1] - R[1, 2]
        q[2] = R[0, 2] - R[2, 0]
        q[3] = R[1, 0] - R[0, 1]
    else:
        i = 0
        if R[1, 1] > R[0, 0]:
            i = 1
        if R[2, 2] > R[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = R[k, j] - R[j, k]
        q[1 + i] = 1 + 2 * R[i, i] - trace
        q[1 + j] = R[j, i] + R[i, j]
        q[1 + k] = R[k, i] + R[i, k]
