"""From Gaussians in the world to splats on the image, and gradients the way back.

A splat is kept in the form in which a row of pixels asks for it. Cut along a row, a 2D Gaussian is
a 1D Gaussian: its centre moves along a line from row to row, its variance is the same on all. So
``alpha(x, y) = opacity exp(-1/2 (e^2 / var + dy^2 / yy))`` with ``dy = y - v``,
``e = x - u - slope dy``, ``slope = xy / yy`` and ``var = xx - xy^2 / yy``. Nothing cancels in that,
however long and thin the splat, as it does in ``a dx^2 + 2 b dx dy + c dy^2``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import (
    LANES,
    vabs,
    vall,
    vceil,
    vfloor,
    vload,
    vlog2,
    vnarrow,
    vsqrt,
    vstore,
    vwhere,
    vwiden,
    vzero,
)
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.api import FRUSTUM_MARGIN
from slgaussian.rasterize.render_settings import Settings
from slgaussian.scene import Camera

U, V, ROOT, SLOPE, ROW_ROOT, POWER, CUT, Z = range(8)
"""Columns of a splat: centre in pixels; the roots of ``k / var`` and ``k / yy`` with ``k = 1/2
log2 e``, and slope; log2 of the opacity, and of the alpha under which it is cut; z. So alpha is
``2^(power - (root e)^2 - (row_root dy)^2)``. A row of float64 is one cache line."""

MOMENTS = 6
"""The gradient of a splat is made of sums over pixels of ``h = alpha dL/dalpha`` times 1, e, e^2,
d, e d and d^2, in this order, where e is times root and d is dy times row_root."""

HALF_LOG2_E = 0.5 * math.log2(math.e)

SHARE = 256 * LANES
"""Gaussians that a thread takes at a time."""

FAR = 1e15
"""Image coordinates are clamped to this, so that nothing overflows in float32."""


class Eye(NamedTuple):
    """A camera, and what of the settings concerns projection, as kernels take them."""

    R: np.ndarray
    """World to camera, float64 [3, 3]."""
    centre: np.ndarray
    fx: float
    skew: float
    cx: float
    fy: float
    cy: float
    width: int
    height: int
    left: float
    """Least x / z at which the affine approximation is taken; likewise right, top, bottom."""
    right: float
    top: float
    bottom: float
    near: float
    low_pass: float
    alpha_min: float
    cut: float
    """The log2 of alpha_min."""
    fraction: float
    """The log2 of the fraction of its opacity below which a splat is also cut."""


def eye_of(camera: Camera, settings: Settings) -> Eye:
    """What kernels need to know of a camera and settings."""
    (fx, skew, cx), (_, fy, cy), _ = camera.K.tolist()
    margin_x = FRUSTUM_MARGIN * camera.width / (2 * fx)
    margin_y = FRUSTUM_MARGIN * camera.height / (2 * fy)
    return Eye(
        R=np.ascontiguousarray(camera.c2w[:3, :3].T),
        centre=np.ascontiguousarray(camera.center),
        fx=fx,
        skew=skew,
        cx=cx,
        fy=fy,
        cy=cy,
        width=camera.width,
        height=camera.height,
        left=-cx / fx - margin_x,
        right=(camera.width - cx) / fx + margin_x,
        top=-cy / fy - margin_y,
        bottom=(camera.height - cy) / fy + margin_y,
        near=settings.near,
        low_pass=settings.low_pass,
        alpha_min=settings.alpha_min,
        cut=math.log2(settings.alpha_min) if settings.alpha_min > 0 else -math.inf,
        fraction=-HALF_LOG2_E * settings.sigmas**2,
    )


def project(
    geometry: Sequence[np.ndarray], values: np.ndarray, eye: Eye
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Project every Gaussian, in float64, a vector of them at a time.

    Parameters
    ----------
    geometry : float32 [N, 3], [N, 3], [N, 4], [N]
        Means, scales, quaternions and opacities.
    values : float32 [N, C]
    eye : Eye

    Returns
    -------
    splats : float64 [N, 8]
    boxes : int32 [N, 4]
        The pixels x0, x1, y0, y1 that a splat may touch, half-open; empty where it is not drawn.
    sensible : bool
        Whether all numbers make sense; where they do not, the splats do not either.
    """
    n = len(values)
    splats, boxes = np.empty((n, 8)), np.empty((n, 4), np.int32)
    sensible = np.ones(-(-n // SHARE), np.bool_)
    share(_project, len(sensible), *geometry, values, eye, splats, boxes, sensible)
    return splats, boxes, bool(sensible.all())


@kernel
def _project(counter, means, scales, quats, opacities, values, eye, splats, boxes, sensible):
    n = len(means)
    numbers, wide = values.reshape(values.size), values.shape[1]
    # Column by column, LANES numbers each.
    given = np.ones(11 * LANES, np.float32)
    made = np.empty(12 * LANES)
    part = take(counter)
    while part < len(sensible):
        start = part * SHARE
        for first in range(start, min(n, start + SHARE), LANES):
            count = min(LANES, n - first)
            for k in range(count):
                for c in range(3):
                    given[c * LANES + k] = means[first + k, c]
                    given[(3 + c) * LANES + k] = scales[first + k, c]
                for c in range(4):
                    given[(6 + c) * LANES + k] = quats[first + k, c]
                given[10 * LANES + k] = opacities[first + k]
            held = _finite(numbers, first * wide, (first + count) * wide)
            if not (_sensible(given) and held):
                sensible[part] = False
            _project_vector(given, eye, made)
            for k in range(count):
                for c in range(8):
                    splats[first + k, c] = made[c * LANES + k]
                for c in range(4):
                    boxes[first + k, c] = np.int32(made[(8 + c) * LANES + k])
        part = take(counter)


@kernel
def _column(given, column):
    return vwiden(vload(given, column * LANES))


@kernel
def _sensible(given):
    """Whether parameters are finite, scales and opacities in range, quaternions not zero."""
    scale_x, scale_y, scale_z = _column(given, 3), _column(given, 4), _column(given, 5)
    # A sum is finite if all its terms are, in float64, where it cannot overflow; and NaN fails
    # every comparison.
    total = _column(given, 0) + _column(given, 1) + _column(given, 2) + scale_x + scale_y + scale_z
    length = vabs(_column(given, 6)) + vabs(_column(given, 7))
    length = length + vabs(_column(given, 8)) + vabs(_column(given, 9))
    opacity = _column(given, 10)
    fine = (vabs(total) < np.inf) & (length > 0.0) & (length < np.inf)
    fine = fine & (scale_x >= 0.0) & (scale_y >= 0.0) & (scale_z >= 0.0)
    return vall(fine & (opacity >= 0.0) & (opacity <= 1.0))


@kernel
def _finite(numbers, start, end):
    """Whether ``numbers`` float32 are, from ``start`` to ``end``."""
    totals, total, at = vzero(), np.float32(0), start
    while at + LANES <= end:
        totals = totals + vload(numbers, at) * np.float32(0)
        at += LANES
    while at < end:
        total += numbers[at] * np.float32(0)
        at += 1
    return total == 0 and vall(totals >= np.float32(0))


@kernel
def _project_vector(given, eye, made):
    """Columns of parameters to those of splats and boxes."""
    x, y, z = _to_camera(_column(given, 0), _column(given, 1), _column(given, 2), eye)
    A = _image_rows(x, y, z, eye)
    R = _rotation(_column(given, 6), _column(given, 7), _column(given, 8), _column(given, 9))
    px, py = _spread(A, R, _column(given, 3), _column(given, 4), _column(given, 5))
    xx, xy, yy, det = _covariance(px, py)
    wide = det + eye.low_pass * (xx + yy) + eye.low_pass * eye.low_pass
    opacity = _column(given, 10)
    xx = xx + eye.low_pass
    yy = yy + eye.low_pass
    u, v = _to_pixel(x, y, eye)
    power = vwiden(vlog2(vnarrow(opacity)))
    cut = power + eye.fraction
    cut = vwhere(cut > eye.cut, cut, eye.cut)
    shown = (z > eye.near) & (opacity > eye.alpha_min)
    # In variances; rounded, it may lack a millionth.
    reach = (power - cut) * (1.000001 / HALF_LOG2_E)
    inverse = 1.0 / yy
    vstore(made, U * LANES, clamp(u, -FAR, FAR))
    vstore(made, V * LANES, clamp(v, -FAR, FAR))
    vstore(made, ROOT * LANES, _root(HALF_LOG2_E * yy / wide))
    vstore(made, SLOPE * LANES, clamp(xy * inverse, -FAR, FAR))
    vstore(made, ROW_ROOT * LANES, _root(HALF_LOG2_E * inverse))
    vstore(made, POWER * LANES, power)
    vstore(made, CUT * LANES, cut)
    vstore(made, Z * LANES, z)
    _store_pixels(u, vwhere(shown, _root(reach * xx), -1.0), eye.width, made, 8)
    _store_pixels(v, vwhere(shown, _root(reach * yy), -1.0), eye.height, made, 10)


@kernel
def _root(x):
    # To the digits of float32, which is what the rest of the way has.
    return vwiden(vsqrt(vnarrow(x)))


@kernel
def _store_pixels(centre, reach, size, made, column):
    """First and one past the last pixel whose centre is within ``reach``; empty if negative."""
    low = vceil(clamp(centre - reach - 0.5, 0.0, size))
    high = vfloor(clamp(centre + reach - 0.5, -1.0, size - 1.0)) + 1.0
    vstore(made, column * LANES, low)
    vstore(made, (column + 1) * LANES, vwhere(high > low, high, low))


def project_backward(
    geometry: Sequence[np.ndarray],
    eye: Eye,
    splats: np.ndarray,
    firsts: np.ndarray,
    grads: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Gradients of the Gaussians from those of the splats.

    Parameters
    ----------
    geometry, eye, splats
        As :func:`project` took and gave them.
    firsts : int64 [N + 1]
        Gaussian i has the rows ``firsts[i]`` to ``firsts[i + 1]`` of ``grads``.
    grads : float32 [rows, MOMENTS + C + 1]
        By tile: the moments, and the gradients of the C values and of z.

    Returns
    -------
    float32 [N, 3], [N, 3], [N, 4], [N], [N, C]
        Of means, scales, quats, opacities and values; zero for what is not drawn.
    """
    n, channels = len(splats), grads.shape[1] - MOMENTS - 1
    found = *map(np.zeros_like, geometry), np.zeros((n, channels), np.float32)
    share(_project_backward, -(-n // SHARE), *geometry, eye, splats, firsts, grads, *found)
    return found


@kernel
def _project_backward(
    counter, means, scales, quats, opacities, eye, splats, firsts, grads, d_means, d_scales,
    d_quats, d_opacities, d_values,
):  # fmt: skip
    n, start = len(means), take(counter) * SHARE
    while start < n:
        for i in range(start, min(n, start + SHARE)):
            _gaussian_backward(
                i, means, scales, quats, opacities, eye, splats, firsts, grads, d_means, d_scales,
                d_quats, d_opacities, d_values,
            )  # fmt: skip
        start = take(counter) * SHARE


@kernel
def _gaussian_backward(
    i, means, scales, quats, opacities, eye, splats, firsts, grads, d_means, d_scales, d_quats,
    d_opacities, d_values,
):  # fmt: skip
    channels = d_values.shape[1]
    if firsts[i] == firsts[i + 1]:
        return
    m0 = m1 = m2 = m3 = m4 = m5 = dz = 0.0
    for row in range(firsts[i], firsts[i + 1]):
        m0 += grads[row, 0]
        m1 += grads[row, 1]
        m2 += grads[row, 2]
        m3 += grads[row, 3]
        m4 += grads[row, 4]
        m5 += grads[row, 5]
        for k in range(channels):
            d_values[i, k] += grads[row, MOMENTS + k]
        dz += grads[row, MOMENTS + channels]
    root, slope, row_root = splats[i, ROOT], splats[i, SLOPE], splats[i, ROW_ROOT]
    row_precision = row_root * row_root / HALF_LOG2_E
    du = root * m1 / HALF_LOG2_E
    dv = row_root * m3 / HALF_LOG2_E - slope * du
    # var = xx - xy^2 / yy, slope = xy / yy.
    d_var = 0.5 * (root * root / HALF_LOG2_E) * m2 / HALF_LOG2_E
    d_slope = root / row_root * m4 / HALF_LOG2_E
    dxx = d_var
    dxy = d_slope * row_precision - 2 * slope * d_var
    dyy = slope * slope * d_var - slope * row_precision * d_slope
    dyy += 0.5 * row_precision * m5 / HALF_LOG2_E

    x, y, z = _to_camera(*_three(means[i]), eye)
    A = _image_rows(x, y, z, eye)
    qw, qx, qy, qz = quats[i]
    R = _rotation(np.float64(qw), np.float64(qx), np.float64(qy), np.float64(qz))
    px, py = _spread(A, R, *_three(scales[i]))
    d_opacities[i] = m0 / math.exp2(splats[i, POWER])

    dAx0 = dAx1 = dAx2 = dAy0 = dAy1 = dAy2 = 0.0
    dR = np.empty((3, 3))
    for k in range(3):
        dpx = 2 * dxx * px[k] + dxy * py[k]
        dpy = 2 * dyy * py[k] + dxy * px[k]
        sx, sy = scales[i, k] * dpx, scales[i, k] * dpy
        dAx0 += sx * R[0][k]
        dAx1 += sx * R[1][k]
        dAx2 += sx * R[2][k]
        dAy0 += sy * R[0][k]
        dAy1 += sy * R[1][k]
        dAy2 += sy * R[2][k]
        d_scales[i, k] = dpx * (A[0][0] * R[0][k] + A[0][1] * R[1][k] + A[0][2] * R[2][k]) + dpy * (
            A[1][0] * R[0][k] + A[1][1] * R[1][k] + A[1][2] * R[2][k]
        )
        for j in range(3):
            dR[j, k] = sx * A[0][j] + sy * A[1][j]
    _rotation_backward(quats[i], dR, d_quats[i])

    # A = J W with J = [[fx, skew, -(fx tx + skew ty)], [0, fy, -fy ty]] / z.
    W = eye.R
    dJ00 = dAx0 * W[0, 0] + dAx1 * W[0, 1] + dAx2 * W[0, 2]
    dJ01 = dAx0 * W[1, 0] + dAx1 * W[1, 1] + dAx2 * W[1, 2]
    dJ02 = dAx0 * W[2, 0] + dAx1 * W[2, 1] + dAx2 * W[2, 2]
    dJ11 = dAy0 * W[1, 0] + dAy1 * W[1, 1] + dAy2 * W[1, 2]
    dJ12 = dAy0 * W[2, 0] + dAy1 * W[2, 1] + dAy2 * W[2, 2]
    tx, ty = clamp(x, eye.left, eye.right), clamp(y, eye.top, eye.bottom)
    dz -= (
        dJ00 * eye.fx
        + dJ01 * eye.skew
        - dJ02 * (eye.fx * tx + eye.skew * ty)
        + dJ11 * eye.fy
        - dJ12 * eye.fy * ty
    ) / (z * z)
    dx = du * eye.fx
    dy = du * eye.skew + dv * eye.fy
    if tx == x:
        dx -= dJ02 * eye.fx / z
    if ty == y:
        dy -= (dJ02 * eye.skew + dJ12 * eye.fy) / z
    # x and y are divided by z already.
    dz -= (dx * x + dy * y) / z
    for k in range(3):
        d_means[i, k] = (dx * W[0, k] + dy * W[1, k]) / z + dz * W[2, k]


@kernel
def _three(row):
    return np.float64(row[0]), np.float64(row[1]), np.float64(row[2])


# From here to the covariance, numbers are float64 scalars or vectors.


@kernel
def clamp(x, low, high):
    """``x``, but at least ``low`` and at most ``high``."""
    x = vwhere(x > low, x, low)
    return vwhere(x < high, x, high)


@kernel
def _to_camera(x, y, z, eye):
    """x / z, y / z and z; z as it is, but 1 for the divisions where it is not past near."""
    x = x - eye.centre[0]
    y = y - eye.centre[1]
    z = z - eye.centre[2]
    R = eye.R
    depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
    inverse = 1.0 / vwhere(depth > eye.near, depth, 1.0)
    return (
        (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z) * inverse,
        (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z) * inverse,
        depth,
    )


@kernel
def _to_pixel(x, y, eye):
    return eye.fx * x + eye.skew * y + eye.cx, eye.fy * y + eye.cy


@kernel
def _image_rows(x, y, z, eye):
    """How image x and y change with the world position, to first order: two rows of three."""
    tx, ty = clamp(x, eye.left, eye.right), clamp(y, eye.top, eye.bottom)
    inverse = 1.0 / vwhere(z > eye.near, z, 1.0)
    a, b, c = eye.fx * inverse, eye.skew * inverse, -(eye.fx * tx + eye.skew * ty) * inverse
    d, e = eye.fy * inverse, -eye.fy * ty * inverse
    R = eye.R
    return (
        (
            a * R[0, 0] + b * R[1, 0] + c * R[2, 0],
            a * R[0, 1] + b * R[1, 1] + c * R[2, 1],
            a * R[0, 2] + b * R[1, 2] + c * R[2, 2],
        ),
        (
            d * R[1, 0] + e * R[2, 0],
            d * R[1, 1] + e * R[2, 1],
            d * R[1, 2] + e * R[2, 2],
        ),
    )


@kernel
def _rotation(w, x, y, z):
    """Rows of the rotation matrix of a quaternion of any length but zero."""
    t = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - t * (y * y + z * z), t * (x * y - w * z), t * (x * z + w * y)),
        (t * (x * y + w * z), 1.0 - t * (x * x + z * z), t * (y * z - w * x)),
        (t * (x * z - w * y), t * (y * z + w * x), 1.0 - t * (x * x + y * y)),
    )


@kernel
def _rotation_backward(quat, dR, out):
    """Write the gradient of the quaternion to ``out``; it is orthogonal to the quaternion."""
    w, x, y, z = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    length = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / length, x / length, y / length, z / length
    dw = 2 * (x * (dR[2, 1] - dR[1, 2]) + y * (dR[0, 2] - dR[2, 0]) + z * (dR[1, 0] - dR[0, 1]))
    dx = 2 * (
        y * (dR[0, 1] + dR[1, 0])
        + z * (dR[0, 2] + dR[2, 0])
        + w * (dR[2, 1] - dR[1, 2])
        - 2 * x * (dR[1, 1] + dR[2, 2])
    )
    dy = 2 * (
        x * (dR[0, 1] + dR[1, 0])
        + z * (dR[1, 2] + dR[2, 1])
        + w * (dR[0, 2] - dR[2, 0])
        - 2 * y * (dR[0, 0] + dR[2, 2])
    )
    dz = 2 * (
        x * (dR[0, 2] + dR[2, 0])
        + y * (dR[1, 2] + dR[2, 1])
        + w * (dR[1, 0] - dR[0, 1])
        - 2 * z * (dR[0, 0] + dR[1, 1])
    )
    along = w * dw + x * dx + y * dy + z * dz
    out[0] = (dw - along * w) / length
    out[1] = (dx - along * x) / length
    out[2] = (dy - along * y) / length
    out[3] = (dz - along * z) / length


@kernel
def _spread(A, R, s0, s1, s2):
    """The three axes of a Gaussian, scaled, on the image: x and y of each, in pixels."""
    (a, b, c), (d, e, f) = A
    return (
        (
            s0 * (a * R[0][0] + b * R[1][0] + c * R[2][0]),
            s1 * (a * R[0][1] + b * R[1][1] + c * R[2][1]),
            s2 * (a * R[0][2] + b * R[1][2] + c * R[2][2]),
        ),
        (
            s0 * (d * R[0][0] + e * R[1][0] + f * R[2][0]),
            s1 * (d * R[0][1] + e * R[1][1] + f * R[2][1]),
            s2 * (d * R[0][2] + e * R[1][2] + f * R[2][2]),
        ),
    )


@kernel
def _covariance(px, py):
    """xx, xy, yy and the determinant of the sum of the outer products of three axes.

    The determinant is a sum of squares (Cauchy and Binet), so that it does not cancel.
    """
    xx = px[0] * px[0] + px[1] * px[1] + px[2] * px[2]
    xy = px[0] * py[0] + px[1] * py[1] + px[2] * py[2]
    yy = py[0] * py[0] + py[1] * py[1] + py[2] * py[2]
    a = px[0] * py[1] - px[1] * py[0]
    b = px[0] * py[2] - px[2] * py[0]
    c = px[1] * py[2] - px[2] * py[1]
    return xx, xy, yy, a * a + b * b + c * c
