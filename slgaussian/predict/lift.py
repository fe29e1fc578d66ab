"""From depth maps to Gaussians: one thin disc a pixel, lying along the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numba import njit, prange

from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.scene import View

FOOTPRINT = 0.45
"""Standard deviation of a disc across the line of sight, in pixels of its own view. With the
rasterizer's low-pass a surface then has no holes; larger ones blur (0.6 cost half a decibel
in novel views)."""

THICKNESS = 0.1
"""Standard deviation along the normal, as a share of that across the line of sight."""

MIN_COSINE = 0.25
"""Surfaces seen at a flatter angle than this are stretched no further."""

SLOPE_RADIUS = 3
SAME_SURFACE = 0.03
"""Window, and largest relative step of inverse depth in it, from which a normal is estimated."""


def lift(
    views: Sequence[View],
    gains: np.ndarray,
    inverse_depths: Sequence[np.ndarray],
    opacities: Sequence[np.ndarray],
) -> Gaussians:
    """One Gaussian a context pixel, in the order of ``source``.

    Parameters
    ----------
    views : V views of one size
    gains : float [V, 3]
        Factors on the RGB values of each view.
    inverse_depths : V of float32 [H, W]
        1 / z, positive and finite.
    opacities : V of float32 [H, W]

    Returns
    -------
    Gaussians
        V * H * W of them in world space, spherical harmonics of degree 0.
    """
    parts = [_lift_view(*one) for one in zip(views, inverse_depths, strict=True)]
    means, scales, quats = (np.concatenate(p) for p in zip(*parts, strict=True))
    colors = [
        v.image.reshape(-1, 3) * np.float32(g / 255) for v, g in zip(views, gains, strict=True)
    ]
    return Gaussians(
        means=torch.from_numpy(means.astype(np.float32)),
        scales=torch.from_numpy(scales),
        quats=torch.from_numpy(quats),
        opacities=torch.from_numpy(np.concatenate([o.ravel() for o in opacities])),
        sh=rgb_to_sh(torch.from_numpy(np.concatenate(colors).clip(0, 1))),
        source=torch.arange(len(means), dtype=torch.int32),
    )


def _lift_view(view: View, inverse_depth: np.ndarray) -> tuple[np.ndarray, ...]:
    camera = view.camera
    depth = 1 / inverse_depth.astype(np.float64)
    local = normals(inverse_depth, camera.K)
    footprint = FOOTPRINT / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    scales, quats = _discs(
        local, depth, np.linalg.inv(camera.K), np.ascontiguousarray(camera.c2w[:3, :3]), footprint
    )
    return camera.unproject(depth).reshape(-1, 3), scales, quats


def normals(inverse_depth: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Unit surface normals float64 [H, W, 3] in camera coordinates, facing the camera.

    A plane ``n . X = 1`` has inverse depth ``w = (K^-T n) . (u, v, 1)``: linear in the pixel, so
    its normal follows from the slope of ``w``, fitted to the pixels nearby on the same surface.
    """
    slope = _slopes(inverse_depth, SLOPE_RADIUS, SAME_SURFACE).astype(np.float64)
    H, W = inverse_depth.shape
    u, v = np.arange(W) + 0.5, np.arange(H)[:, None] + 0.5
    du, dv = slope[..., 0], slope[..., 1]
    away = np.stack([du, dv, inverse_depth - u * du - v * dv], -1) @ K
    return -away / np.linalg.norm(away, axis=-1, keepdims=True)


@njit(cache=True, parallel=True)
def _slopes(values, radius, same):
    """Least-squares slope (d/dx, d/dy) over the window pixels within a share ``same`` of each."""
    H, W = values.shape
    out = np.zeros((H, W, 2), np.float32)
    for y in prange(H):
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
            # Centred moments; a window that is a point or a line in the image says nothing.
            a, b, c = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            p, q = sxw - sx * sw / n, syw - sy * sw / n
            det = a * c - b * b
            if n >= 6 and det > 1e-3 * n * n:
                out[y, x, 0] = (c * p - b * q) / det
                out[y, x, 1] = (a * q - b * p) / det
    return out


@njit(cache=True, parallel=True)
def _discs(normal, depth, K_inverse, R, footprint):
    """Scales [H * W, 3] and world quaternions wxyz [H * W, 4] of discs with these normals.

    Local axes are (across the line of sight, uphill along the surface, normal).
    """
    H, W = depth.shape
    scales = np.empty((H * W, 3), np.float32)
    quats = np.empty((H * W, 4), np.float32)
    for y in prange(H):
        for x in range(W):
            n = normal[y, x]
            s = K_inverse @ np.array([x + 0.5, y + 0.5, 1.0])
            s /= np.sqrt((s * s).sum())
            across = _cross(n, s)
            tilt = np.sqrt((across * across).sum())
            if tilt < 1e-6:
                # Seen squarely: any axis in the plane will do.
                across = _cross(n, np.array([0.0, 1.0, 0.0]))
                tilt = np.sqrt((across * across).sum())
            across /= tilt
            axes = np.empty((3, 3))
            axes[:, 0] = across
            axes[:, 1] = _cross(n, across)
            axes[:, 2] = n
            width = footprint * depth[y, x]
            k = y * W + x
            scales[k, 0] = width
            scales[k, 1] = width / max(abs((n * s).sum()), MIN_COSINE)
            scales[k, 2] = width * THICKNESS
            quats[k] = _quaternion(R @ axes)
    return scales, quats


@njit(cache=True)
def _cross(a, b):
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@njit(cache=True)
def _quaternion(R):
    """Unit quaternion wxyz of a rotation, from its largest component (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    q = np.empty(4)
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
    return q / np.sqrt((q * q).sum())
