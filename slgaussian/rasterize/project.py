"""Projection of Gaussians to splats on the image, and its gradients.

A splat is stored in a form suited to rows of pixels. Along a row, a 2D Gaussian is a 1D Gaussian
whose centre moves linearly from row to row and whose variance is constant. So
``alpha(x, y) = opacity exp(-1/2 (e^2 / var + dy^2 / yy))`` with ``dy = y - v``,
``e = x - u - slope dy``, ``slope = xy / yy`` and ``var = xx - xy^2 / yy``. This form has no
cancellation for long and thin splats, unlike ``a dx^2 + 2 b dx dy + c dy^2``.

The covariance is that of EWA splatting (Zwicker et al. 2001; Kerbl et al. 2023, eq. 5 and
6): ``Sigma' = J W R S S^T R^T W^T J^T + low_pass I``, with S the scales, R the rotation of the
Gaussian, W that of world to camera, and J the Jacobian of perspective at the centre. It is computed
from the three columns of ``P = J W R S``, the axes of the Gaussian on the image.
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

GAUSSIANS_PER_ITEM = 256 * LANES
"""Gaussians of a work item."""

MAX_COORDINATE = 1e15
"""Bound of image coordinates, so that nothing overflows in float32."""


class Eye(NamedTuple):
    """A camera and the settings of projection, as arguments of kernels."""

    R: tuple[tuple[float, ...], ...]
    """Rotation of world to camera, in rows."""
    centre: tuple[float, ...]
    fx: float
    skew: float
    cx: float
    fy: float
    cy: float
    width: int
    height: int
    left: float
    """Smallest x / z of the affine approximation; likewise right, top, bottom."""
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


def make_eye(camera: Camera, settings: Settings) -> Eye:
    """Convert a camera and settings for kernels."""
    (fx, skew, cx), (_, fy, cy), _ = camera.K.tolist()
    margin_x = FRUSTUM_MARGIN * camera.width / (2 * fx)
    margin_y = FRUSTUM_MARGIN * camera.height / (2 * fy)
    return Eye(
        R=tuple(map(tuple, camera.c2w[:3, :3].T.tolist())),
        centre=tuple(camera.center.tolist()),
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
    """Project every Gaussian in float64, a SIMD vector at a time.

    Args:
        geometry: float32 [N, 3], [N, 3], [N, 4], [N]. Means, scales, quaternions and opacities.
        values: float32 [N, C]

    Returns:
        splats: float64 [N, 8]
        boxes: int32 [N, 4]. The pixels x0, x1, y0, y1 that a splat may touch, half-open; empty
            where it is not drawn.
        sensible: bool. Whether all numbers make sense; where they do not, the splats do not either.
    """
    n = len(values)
    splats, boxes = np.empty((n, 8)), np.empty((n, 4), np.int32)
    sensible = np.ones(-(-n // GAUSSIANS_PER_ITEM), np.bool_)
    share(_project, len(sensible), *geometry, values, eye, splats, boxes, sensible)
    return splats, boxes, bool(sensible.all())


@kernel
def _project(counter, means, scales, quats, opacities, values, eye, splats, boxes, sensible):
    n = len(means)
    numbers, wide = values.reshape(values.size), values.shape[1]
    # A lane holds one Gaussian. Its 11 parameters and 12 results are transposed on the way, so that
    # each is one contiguous vector of LANES Gaussians. Lanes past the last Gaussian keep the ones
    # of the start or an earlier Gaussian: valid numbers, whose results are not stored.
    parameters = np.ones(11 * LANES, np.float32)
    outputs = np.empty(12 * LANES)
    part = take(counter)
    while part < len(sensible):
        start = part * GAUSSIANS_PER_ITEM
        for first in range(start, min(n, start + GAUSSIANS_PER_ITEM), LANES):
            count = min(LANES, n - first)
            for k in range(count):
                for c in range(3):
                    parameters[c * LANES + k] = means[first + k, c]
                    parameters[(3 + c) * LANES + k] = scales[first + k, c]
                for c in range(4):
                    parameters[(6 + c) * LANES + k] = quats[first + k, c]
                parameters[10 * LANES + k] = opacities[first + k]
            values_finite = _is_finite(numbers, first * wide, (first + count) * wide)
            # The caller names the first invalid number: looking for it here would cost every frame.
            if not (_is_valid(parameters) and values_finite):
                sensible[part] = False
            _project_vector(parameters, eye, outputs)
            for k in range(count):
                for c in range(8):
                    splats[first + k, c] = outputs[c * LANES + k]
                for c in range(4):
                    boxes[first + k, c] = np.int32(outputs[(8 + c) * LANES + k])
        part = take(counter)


@kernel(inline="always")
def _column(parameters, column):
    return vwiden(vload(parameters, column * LANES))


@kernel(inline="always")
def _three(parameters, first):
    """Return three columns of parameters."""
    x, y = _column(parameters, first), _column(parameters, first + 1)
    return x, y, _column(parameters, first + 2)


@kernel(inline="always")
def _is_valid(parameters):
    """Test that parameters are finite, scales and opacities in range, and quaternions nonzero."""
    x, y, z = _three(parameters, 0)
    scale_x, scale_y, scale_z = _three(parameters, 3)
    # A sum is finite if all its terms are, in float64, where it cannot overflow; and NaN fails
    # every comparison.
    total = x + y + z + scale_x + scale_y + scale_z
    a, b, c = _three(parameters, 6)
    length = vabs(a) + vabs(b) + vabs(c) + vabs(_column(parameters, 9))
    opacity = _column(parameters, 10)
    fine = (vabs(total) < np.inf) & (length > 0.0) & (length < np.inf)
    fine = fine & (scale_x >= 0.0) & (scale_y >= 0.0) & (scale_z >= 0.0)
    return vall(fine & (opacity >= 0.0) & (opacity <= 1.0))


@kernel(inline="always")
def _is_finite(numbers, start, end):
    """Test that ``numbers`` float32 are finite from ``start`` to ``end``."""
    # 0 times a finite number is 0, of NaN and infinity NaN; a NaN remains in the sum and fails the
    # comparisons. So no number is tested on its own.
    totals, total, at = vzero(), np.float32(0), start
    while at + LANES <= end:
        totals = totals + vload(numbers, at) * np.float32(0)
        at += LANES
    while at < end:
        total += numbers[at] * np.float32(0)
        at += 1
    return total == 0 and vall(totals >= np.float32(0))


@kernel(inline="always")
def _project_vector(parameters, eye, outputs):
    """Convert columns of parameters to those of splats and boxes."""
    x, y, z = _to_camera(*_three(parameters, 0), eye)
    qw, qx, qy = _three(parameters, 6)
    R = _rotation(qw, qx, qy, _column(parameters, 9))
    (a, b, c), (d, e, f) = _axes(_image_rows(x, y, z, eye), R)
    sx, sy, sz = _three(parameters, 3)
    xx, xy, yy, det = _covariance((sx * a, sy * b, sz * c), (sx * d, sy * e, sz * f))
    # det(Sigma + l I) = det Sigma + l tr Sigma + l^2: a sum of terms of one sign, so that it keeps
    # its digits where the splat is thin, and xx yy - xy^2 would cancel.
    wide = det + eye.low_pass * (xx + yy) + eye.low_pass * eye.low_pass
    opacity = _column(parameters, 10)
    xx = xx + eye.low_pass
    yy = yy + eye.low_pass
    u, v = eye.fx * x + eye.skew * y + eye.cx, eye.fy * y + eye.cy
    # Alphas are compared as logarithms: blending has them as exponents of 2 anyway, and a product
    # of opacity and Gaussian becomes a sum.
    power = vwiden(vlog2(vnarrow(opacity)))
    cut = power + eye.fraction
    cut = vwhere(cut > eye.cut, cut, eye.cut)
    visible = (z > eye.near) & (opacity > eye.alpha_min)
    # The squared Mahalanobis distance at which alpha falls to the cut. Over all y, the Gaussian's
    # ellipse of that radius reaches sqrt(reach xx) to each side, and sqrt(reach yy) up and down.
    # Rounded, it may lack a millionth.
    reach = (power - cut) * (1.000001 / HALF_LOG2_E)
    inverse = 1.0 / yy
    # var = xx - xy^2 / yy = det(Sigma') / yy, so that 1 / var is yy / wide, without cancellation.
    vstore(outputs, U * LANES, clamp(u, -MAX_COORDINATE, MAX_COORDINATE))
    vstore(outputs, V * LANES, clamp(v, -MAX_COORDINATE, MAX_COORDINATE))
    vstore(outputs, ROOT * LANES, _root(HALF_LOG2_E * yy / wide))
    vstore(outputs, SLOPE * LANES, clamp(xy * inverse, -MAX_COORDINATE, MAX_COORDINATE))
    vstore(outputs, ROW_ROOT * LANES, _root(HALF_LOG2_E * inverse))
    vstore(outputs, POWER * LANES, power)
    vstore(outputs, CUT * LANES, cut)
    vstore(outputs, Z * LANES, z)
    _store_pixels(u, vwhere(visible, _root(reach * xx), -1.0), eye.width, outputs, 8)
    _store_pixels(v, vwhere(visible, _root(reach * yy), -1.0), eye.height, outputs, 10)


@kernel(inline="always")
def _root(x):
    # To the digits of float32, which is all that blending has.
    return vwiden(vsqrt(vnarrow(x)))


@kernel(inline="always")
def _store_pixels(centre, reach, size, outputs, column):
    """Store the half-open range of pixels with centres within ``reach``; empty if negative."""
    # Pixel i has its centre at i + 0.5. In float64, as int32 would overflow before the clamp.
    low = vceil(clamp(centre - reach - 0.5, 0.0, size))
    high = vfloor(clamp(centre + reach - 0.5, -1.0, size - 1.0)) + 1.0
    vstore(outputs, column * LANES, low)
    vstore(outputs, (column + 1) * LANES, vwhere(high > low, high, low))


def project_backward(
    geometry: Sequence[np.ndarray],
    eye: Eye,
    splats: np.ndarray,
    firsts: np.ndarray,
    grads: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Compute the gradients of the Gaussians from those of the splats.

    Args:
        geometry, eye, splats: Arguments and result of :func:`project`.
        firsts: int64 [N + 1]. Gaussian i has the rows ``firsts[i]`` to ``firsts[i + 1]`` of
            ``grads``.
        grads: float32 [rows, MOMENTS + C + 1]. By tile: the moments, and the gradients of the C
            values and of z.

    Returns:
        float32 [N, 3], [N, 3], [N, 4], [N], [N, C]: Of means, scales, quats, opacities and values;
            zero for what is not drawn.
    """
    n, channels = len(splats), grads.shape[1] - MOMENTS - 1
    gradients = *map(np.zeros_like, geometry), np.zeros((n, channels), np.float32)
    items = -(-n // GAUSSIANS_PER_ITEM)
    share(_project_backward, items, *geometry, eye, splats, firsts, grads, *gradients)
    return gradients


@kernel
def _project_backward(
    counter, means, scales, quats, opacities, eye, splats, firsts, grads, d_means, d_scales,
    d_quats, d_opacities, d_values,
):  # fmt: skip
    # One Gaussian at a time, without lanes, as numbers of rows differ. The thread that has it adds
    # its rows in the order of the tiles: no atomics, and the same bytes with any number of threads.
    n, channels, W = len(means), d_values.shape[1], eye.R
    m, dA, dR = np.empty(MOMENTS), np.empty((2, 3)), np.empty((3, 3))
    start = take(counter) * GAUSSIANS_PER_ITEM
    while start < n:
        for i in range(start, min(n, start + GAUSSIANS_PER_ITEM)):
            if firsts[i] == firsts[i + 1]:
                continue
            m[:], dA[:], dz = 0, 0, 0.0
            for row in range(firsts[i], firsts[i + 1]):
                for k in range(MOMENTS):
                    m[k] += grads[row, k]
                for k in range(channels):
                    d_values[i, k] += grads[row, MOMENTS + k]
                dz += grads[row, MOMENTS + channels]
            # Each gradient is the sum over pixels of h = alpha dL/dalpha times the derivative of
            # ln alpha, and the moments hold that: dL/du is the sum of h e / var, which is root / k
            # times m[1], the sum of h (root e), as root^2 is k / var with k = HALF_LOG2_E.
            root, slope, row_root = splats[i, ROOT], splats[i, SLOPE], splats[i, ROW_ROOT]
            row_precision = row_root * row_root / HALF_LOG2_E
            du = root * m[1] / HALF_LOG2_E
            dv = row_root * m[3] / HALF_LOG2_E - slope * du
            # By the chain rule through var = xx - xy^2 / yy and slope = xy / yy; dL/dxx is d_var.
            # The low-pass filter is a constant in xx and yy, and has no part in it.
            d_var = 0.5 * (root * root / HALF_LOG2_E) * m[2] / HALF_LOG2_E
            d_slope = root / row_root * m[4] / HALF_LOG2_E
            dxy = d_slope * row_precision - 2 * slope * d_var
            dyy = slope * slope * d_var - slope * row_precision * d_slope
            dyy += 0.5 * row_precision * m[5] / HALF_LOG2_E
            d_opacities[i] = m[0] / math.exp2(splats[i, POWER])

            x, y, z = _to_camera(
                np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2]), eye
            )
            # Recomputed, so that the forward pass stores nothing but the splats.
            A = _image_rows(x, y, z, eye)
            qw, qx, qy, qz = quats[i]
            R = _rotation(np.float64(qw), np.float64(qx), np.float64(qy), np.float64(qz))
            axes = _axes(A, R)
            # Column k of P = A R S on the image is (px, py), and Sigma' = P P^T: xx = sum px^2,
            # xy = sum px py, yy = sum py^2 over the three axes.
            for k in range(3):
                scale, axis_x, axis_y = scales[i, k], axes[0][k], axes[1][k]
                px, py = scale * axis_x, scale * axis_y
                dpx = 2 * d_var * px + dxy * py
                dpy = 2 * dyy * py + dxy * px
                d_scales[i, k] = dpx * axis_x + dpy * axis_y
                for j in range(3):
                    dA[0, j] += scale * dpx * R[j][k]
                    dA[1, j] += scale * dpy * R[j][k]
                    dR[j, k] = scale * dpx * A[0][j] + scale * dpy * A[1][j]
            _rotation_backward(quats[i], dR, d_quats[i])

            # A = J W with J = [[fx, skew, -(fx tx + skew ty)], [0, fy, -fy ty]] / z.
            dJ00 = dA[0, 0] * W[0][0] + dA[0, 1] * W[0][1] + dA[0, 2] * W[0][2]
            dJ01 = dA[0, 0] * W[1][0] + dA[0, 1] * W[1][1] + dA[0, 2] * W[1][2]
            dJ02 = dA[0, 0] * W[2][0] + dA[0, 1] * W[2][1] + dA[0, 2] * W[2][2]
            dJ11 = dA[1, 0] * W[1][0] + dA[1, 1] * W[1][1] + dA[1, 2] * W[1][2]
            dJ12 = dA[1, 0] * W[2][0] + dA[1, 1] * W[2][1] + dA[1, 2] * W[2][2]
            tx, ty = clamp(x, eye.left, eye.right), clamp(y, eye.top, eye.bottom)
            by_depth = dJ00 * eye.fx + dJ01 * eye.skew - dJ02 * (eye.fx * tx + eye.skew * ty)
            by_depth = by_depth + dJ11 * eye.fy - dJ12 * eye.fy * ty
            dz -= by_depth / (z * z)
            dx = du * eye.fx
            dy = du * eye.skew + dv * eye.fy
            # Where the point of evaluation is clamped to the frustum, J does not move with the
            # mean.
            if tx == x:
                dx -= dJ02 * eye.fx / z
            if ty == y:
                dy -= (dJ02 * eye.skew + dJ12 * eye.fy) / z
            # x and y are divided by z already.
            dz -= (dx * x + dy * y) / z
            for k in range(3):
                d_means[i, k] = (dx * W[0][k] + dy * W[1][k]) / z + dz * W[2][k]
        start = take(counter) * GAUSSIANS_PER_ITEM


# From here to the covariance, numbers are float64 scalars or vectors: the forward pass has a vector
# of Gaussians, the backward pass one Gaussian, by the same formulas.


@kernel(inline="always")
def clamp(x, low, high):
    """Clamp ``x`` to ``low`` and ``high``."""
    x = vwhere(x > low, x, low)
    return vwhere(x < high, x, high)


@kernel
def _to_camera(x, y, z, eye):
    """Return x / z, y / z and z; at or before the near plane the divisor is 1."""
    x = x - eye.centre[0]
    y = y - eye.centre[1]
    z = z - eye.centre[2]
    R = eye.R
    depth = R[2][0] * x + R[2][1] * y + R[2][2] * z
    inverse = 1.0 / vwhere(depth > eye.near, depth, 1.0)
    return (
        (R[0][0] * x + R[0][1] * y + R[0][2] * z) * inverse,
        (R[1][0] * x + R[1][1] * y + R[1][2] * z) * inverse,
        depth,
    )


@kernel(inline="always")
def _image_rows(x, y, z, eye):
    """Return the Jacobian of image x and y by the world position: two rows of three."""
    # J W with J = [[fx, skew, -(fx tx + skew ty)], [0, fy, -fy ty]] / z. The point (tx, ty) is the
    # centre, clamped to the frustum and a margin: outside, the affine approximation of a
    # perspective that no longer is nearly affine would smear the splat over the image.
    tx, ty = clamp(x, eye.left, eye.right), clamp(y, eye.top, eye.bottom)
    inverse = 1.0 / vwhere(z > eye.near, z, 1.0)
    d, e = eye.fy * inverse, -eye.fy * ty * inverse
    R = eye.R
    return (
        _multiply(
            eye.fx * inverse, eye.skew * inverse, -(eye.fx * tx + eye.skew * ty) * inverse, R
        ),
        (d * R[1][0] + e * R[2][0], d * R[1][1] + e * R[2][1], d * R[1][2] + e * R[2][2]),
    )


@kernel(inline="always")
def _multiply(a, b, c, R):
    """Multiply the row vector (a, b, c) with the matrix ``R``, given in rows."""
    return (
        a * R[0][0] + b * R[1][0] + c * R[2][0],
        a * R[0][1] + b * R[1][1] + c * R[2][1],
        a * R[0][2] + b * R[1][2] + c * R[2][2],
    )


@kernel(inline="always")
def _rotation(w, x, y, z):
    """Return the rows of the rotation matrix of a quaternion of any nonzero length."""
    t = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - t * (y * y + z * z), t * (x * y - w * z), t * (x * z + w * y)),
        (t * (x * y + w * z), 1.0 - t * (x * x + z * z), t * (y * z - w * x)),
        (t * (x * z - w * y), t * (y * z + w * x), 1.0 - t * (x * x + y * y)),
    )


@kernel
def _rotation_backward(quat, dR, out):
    """Write the gradient of the quaternion to ``out``; it is orthogonal to the quaternion."""
    # From the transpose of the derivative of the unit quaternion's matrix; then through q / |q|,
    # which takes out the part along q and divides by the length.
    w, x, y, z = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    length = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / length, x / length, y / length, z / length
    xy, xz, yz = dR[0, 1] + dR[1, 0], dR[0, 2] + dR[2, 0], dR[1, 2] + dR[2, 1]
    wx, wy, wz = dR[2, 1] - dR[1, 2], dR[0, 2] - dR[2, 0], dR[1, 0] - dR[0, 1]
    dw = 2 * (x * wx + y * wy + z * wz)
    dx = 2 * (y * xy + z * xz + w * wx - 2 * x * (dR[1, 1] + dR[2, 2]))
    dy = 2 * (x * xy + z * yz + w * wy - 2 * y * (dR[0, 0] + dR[2, 2]))
    dz = 2 * (x * xz + y * yz + w * wz - 2 * z * (dR[0, 0] + dR[1, 1]))
    along = w * dw + x * dx + y * dy + z * dz
    out[0] = (dw - along * w) / length
    out[1] = (dx - along * x) / length
    out[2] = (dy - along * y) / length
    out[3] = (dz - along * z) / length


@kernel(inline="always")
def _axes(A, R):
    """Project the three axes of a Gaussian of unit scales: x and y of each, in pixels."""
    (a, b, c), (d, e, f) = A
    return _multiply(a, b, c, R), _multiply(d, e, f, R)


@kernel(inline="always")
def _covariance(px, py):
    """Return xx, xy, yy and the determinant of the sum of the outer products of three axes.

    The determinant is a sum of squares (Cauchy-Binet), without cancellation.
    """
    xx = px[0] * px[0] + px[1] * px[1] + px[2] * px[2]
    xy = px[0] * py[0] + px[1] * py[1] + px[2] * py[2]
    yy = py[0] * py[0] + py[1] * py[1] + py[2] * py[2]
    a = px[0] * py[1] - px[1] * py[0]
    b = px[0] * py[2] - px[2] * py[0]
    c = px[1] * py[2] - px[2] * py[1]
    return xx, xy, yy, a * a + b * b + c * c
