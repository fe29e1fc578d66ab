"""Exact intersections of rays with boxes, spheres, cylinders, cones and tori.

A solid lives in its own frame, centred at the origin: a box has half extents ``size``; a sphere has
radius ``size[0]``; a cylinder and a cone have radius ``size[0]`` and half height ``size[1]`` along
local z, the cone's apex at the top; a torus lies in the local xy plane with ring radius ``size[0]``
and tube radius ``size[1]``. Ray directions need no unit length: a hit is ``origin + t * ray`` with
t in units of the ray, so rays scaled to z = 1 in a camera give t = z-depth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take

BOX, BALL, CYLINDER, CONE, RING = range(5)


@dataclass(frozen=True, eq=False)
class Solid:
    """One solid: its kind, its size (see the module) and its pose in the world.

    ``rotation`` float64 [3, 3] takes local to world directions; ``centre`` is in world units.
    """

    kind: int
    size: tuple[float, ...]
    centre: tuple[float, float, float]
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))

    @property
    def reach(self) -> float:
        """Radius of the smallest sphere around the centre that holds the solid."""
        if self.kind in (BOX, CYLINDER, CONE):
            return math.hypot(*self.size)
        return float(sum(self.size))


class Solids(NamedTuple):
    """Solids as arrays, for the compiled loops: P rows, float64 but for ``kind`` int64.

    ``to_local`` [P, 3, 3] takes world to local directions; ``reach`` [P] bounds each solid.
    """

    kind: np.ndarray
    size: np.ndarray
    centre: np.ndarray
    to_local: np.ndarray
    reach: np.ndarray


def pack(solids: Sequence[Solid]) -> Solids:
    """The arrays of a sequence of solids, in its order."""
    return Solids(
        kind=np.array([s.kind for s in solids], np.int64),
        size=np.array([(*s.size, 0.0, 0.0)[:3] for s in solids], np.float64),
        centre=np.array([s.centre for s in solids], np.float64),
        to_local=np.array([s.rotation.T for s in solids], np.float64),
        reach=np.array([s.reach for s in solids], np.float64),
    )


def cast(solids: Solids, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First solid that each ray meets.

    Parameters
    ----------
    solids : Solids
    origin : float64 [3]
        Where all rays start, outside every solid.
    rays : float64 [H, W, 3]
        Directions of any length.

    Returns
    -------
    t : float64 [H, W]
        Distance in units of the ray; infinity where nothing is met.
    index : int64 [H, W]
        Row of the solid; -1 where nothing is met.
    """
    t = np.empty(rays.shape[:2])
    index = np.empty(rays.shape[:2], np.int64)
    rays = np.ascontiguousarray(rays)
    share(_cast, len(t), solids, np.asarray(origin, np.float64), rays, t, index)
    return t, index


@kernel
def _cast(counter, solids, origin, rays, t, index):
    row = take(counter)
    while row < len(rays):
        for col in range(rays.shape[1]):
            dx, dy, dz = rays[row, col]
            t[row, col], index[row, col] = nearest(
                solids, origin[0], origin[1], origin[2], dx, dy, dz, np.inf
            )
        row = take(counter)


@kernel
def nearest(solids, ox, oy, oz, dx, dy, dz, limit):
    """The smallest t in (0, limit) at which a ray meets a solid, and the solid's row or -1."""
    best, which = limit, -1
    dd = dx * dx + dy * dy + dz * dz
    for p in range(len(solids.kind)):
        x = ox - solids.centre[p, 0]
        y = oy - solids.centre[p, 1]
        z = oz - solids.centre[p, 2]
        along = x * dx + y * dy + z * dz
        beyond = x * x + y * y + z * z - solids.reach[p] ** 2
        if beyond > 0 and (along > 0 or along * along < beyond * dd):
            continue
        a = solids.to_local[p]
        t = _intersect(
            solids.kind[p],
            solids.size[p],
            a[0, 0] * x + a[0, 1] * y + a[0, 2] * z,
            a[1, 0] * x + a[1, 1] * y + a[1, 2] * z,
            a[2, 0] * x + a[2, 1] * y + a[2, 2] * z,
            a[0, 0] * dx + a[0, 1] * dy + a[0, 2] * dz,
            a[1, 0] * dx + a[1, 1] * dy + a[1, 2] * dz,
            a[2, 0] * dx + a[2, 1] * dy + a[2, 2] * dz,
        )
        if 0 < t < best:
            best, which = t, p
    return best, which


@kernel
def normal_at(kind, size, x, y, z):
    """Outward unit normal, in the local frame, at a local point on the solid's surface."""
    if kind == BOX:
        fx, fy, fz = abs(x) / size[0], abs(y) / size[1], abs(z) / size[2]
        if fx >= fy and fx >= fz:
            return math.copysign(1.0, x), 0.0, 0.0
        if fy >= fz:
            return 0.0, math.copysign(1.0, y), 0.0
        return 0.0, 0.0, math.copysign(1.0, z)
    if kind == BALL:
        return x / size[0], y / size[0], z / size[0]
    rho = max(math.hypot(x, y), 1e-300)
    if kind == RING:
        nx, ny, nz = x - size[0] * x / rho, y - size[0] * y / rho, z
        return nx / size[1], ny / size[1], nz / size[1]
    radius, half = size[0], size[1]
    if kind == CYLINDER:
        if abs(z) / half >= rho / radius:
            return 0.0, 0.0, math.copysign(1.0, z)
        return x / rho, y / rho, 0.0
    # The cone's side leans inwards by its half angle; its base faces straight down.
    side = math.hypot(2 * half, radius)
    if (z + half) * radius / side < (radius * (half - z) / (2 * half) - rho) * 2 * half / side:
        return 0.0, 0.0, -1.0
    return x / rho * 2 * half / side, y / rho * 2 * half / side, radius / side


@kernel
def _intersect(kind, size, x, y, z, dx, dy, dz):
    if kind == BOX:
        lo, hi = _slab(x, dx, size[0], -np.inf, np.inf)
        lo, hi = _slab(y, dy, size[1], lo, hi)
        lo, hi = _slab(z, dz, size[2], lo, hi)
        return _entry(lo, hi)
    if kind == BALL:
        a = dx * dx + dy * dy + dz * dz
        b = x * dx + y * dy + z * dz
        lo, hi = _roots(a, b, x * x + y * y + z * z - size[0] ** 2)
        return _entry(lo, hi)
    if kind == CYLINDER:
        lo, hi = _slab(z, dz, size[1], -np.inf, np.inf)
        a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - size[0] ** 2
        if a == 0.0:
            return _entry(lo, hi) if c <= 0 else np.inf
        t0, t1 = _roots(a, b, c)
        return _entry(max(lo, t0), min(hi, t1))
    if kind == CONE:
        return _cone(size[0], size[1], x, y, z, dx, dy, dz)
    return _torus(size[0], size[1], x, y, z, dx, dy, dz)


@kernel
def _slab(x, dx, half, lo, hi):
    """Clip the interval [lo, hi] of t to where |x + t dx| <= half."""
    if dx == 0.0:
        return (lo, hi) if abs(x) <= half else (np.inf, -np.inf)
    t0, t1 = (-half - x) / dx, (half - x) / dx
    return max(lo, min(t0, t1)), min(hi, max(t0, t1))


@kernel
def _entry(lo, hi):
    """First positive end of an interval of t; infinity if it is empty or behind."""
    if lo > hi or hi <= 0:
        return np.inf
    return lo if lo > 0 else hi


@kernel
def _roots(a, b, c):
    """Ordered roots of a t^2 + 2 b t + c with a != 0, without cancellation; (inf, -inf) if none."""
    disc = b * b - a * c
    if disc < 0:
        return np.inf, -np.inf
    q = -(b + math.copysign(math.sqrt(disc), b))
    t0 = q / a
    t1 = c / q if q != 0.0 else 0.0
    return min(t0, t1), max(t0, t1)


@kernel
def _cone(radius, half, x, y, z, dx, dy, dz):
    lo, hi = _slab(z, dz, half, -np.inf, np.inf)
    k2 = (radius / (2 * half)) ** 2
    w = half - z
    a = dx * dx + dy * dy - k2 * dz * dz
    b = x * dx + y * dy + k2 * w * dz
    c = x * x + y * y - k2 * w * w
    if a == 0.0:  # parallel to the side: the inside is a half line
        if b == 0.0:
            return _entry(lo, hi) if c <= 0 else np.inf
        edge = -c / (2 * b)
        return _entry(lo, min(hi, edge)) if b > 0 else _entry(max(lo, edge), hi)
    t0, t1 = _roots(a, b, c)
    if a > 0:
        return _entry(max(lo, t0), min(hi, t1))
    # Steeper than the side: inside before t0 in one nappe and after t1 in the other, and the slab
    # holds only the nappe below the apex.
    if t0 > t1:
        return _entry(lo, hi)
    return min(_entry(lo, min(hi, t0)), _entry(max(lo, t1), hi))


@kernel
def _torus(ring, tube, x, y, z, dx, dy, dz):
    """First positive root of the torus quartic, isolated by the roots of its derivatives."""
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / length, dy / length, dz / length
    # Measured from the point nearest the centre the quartic has no cubic term and is well scaled.
    start = x * dx + y * dy + z * dz
    x, y, z = x - start * dx, y - start * dy, z - start * dz
    m = x * x + y * y + z * z
    span = (ring + tube) ** 2 - m
    if span <= 0:
        return np.inf
    hi = math.sqrt(span) * (1 + 1e-12)
    lo = max(-hi, start)
    if lo >= hi:
        return np.inf
    k = m + ring * ring - tube * tube
    four = 4 * ring * ring
    c2 = 2 * k - four * (dx * dx + dy * dy)
    c1 = -2 * four * (x * dx + y * dy)
    c0 = k * k - four * (x * x + y * y)

    # Turning points of the slope, then of the quartic: between two of them it is monotone.
    bend = math.sqrt(-c2 / 6) if c2 < 0 else 0.0
    left = lo
    previous = lo
    for step in range(3):
        right = -bend if step == 0 else (bend if step == 1 else hi)
        right = min(max(right, lo), hi)
        if right > left:
            turn = _monotone_root(0.0, 4.0, 0.0, 2 * c2, c1, left, right)
            if turn < np.inf:
                t = _monotone_root(1.0, 0.0, c2, c1, c0, previous, turn)
                if t < np.inf:
                    return (t - start) / length
                previous = turn
        left = right
    t = _monotone_root(1.0, 0.0, c2, c1, c0, previous, hi)
    return (t - start) / length


@kernel
def _monotone_root(c4, c3, c2, c1, c0, lo, hi):
    """Root of a quartic that is monotone on [lo, hi], by Newton kept inside a shrinking bracket."""
    at_lo = (((c4 * lo + c3) * lo + c2) * lo + c1) * lo + c0
    at_hi = (((c4 * hi + c3) * hi + c2) * hi + c1) * hi + c0
    if at_lo * at_hi > 0 or at_lo == at_hi:
        return np.inf
    t = 0.5 * (lo + hi)
    for _ in range(80):
        value = (((c4 * t + c3) * t + c2) * t + c1) * t + c0
        if (value > 0) == (at_hi > 0):
            hi = t
        else:
            lo = t
        slope = ((4 * c4 * t + 3 * c3) * t + 2 * c2) * t + c1
        new = t - value / slope if slope != 0.0 else lo
        if not lo < new < hi:
            new = 0.5 * (lo + hi)
        if abs(new - t) <= 1e-15 * (1 + abs(t)):
            return new
        t = new
    return t
