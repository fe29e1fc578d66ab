"""Intersections of rays with boxes, spheres, cylinders, cones and tori.

A solid has a local frame, centred at the origin: a box has half extents ``size``; a sphere has
radius ``size[0]``; a cylinder and a cone have radius ``size[0]`` and half height ``size[1]`` along
local z, the cone's apex at the top; a torus lies in the local xy plane with ring radius ``size[0]``
and tube radius ``size[1]``. Ray directions may have any length: a hit is ``origin + t * ray`` with
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

MAX_STEPS, HIT_DISTANCE = 50_000, 1e-12
"""Largest number of steps along a ray to a torus, and the distance that counts as a hit."""


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
        """Return the radius of the smallest sphere about the centre that contains the solid."""
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
    """Return the arrays of a sequence of solids, in its order."""
    return Solids(
        kind=np.array([s.kind for s in solids], np.int64),
        size=np.array([(*s.size, 0.0, 0.0)[:3] for s in solids], np.float64),
        centre=np.array([s.centre for s in solids], np.float64),
        to_local=np.array([s.rotation.T for s in solids], np.float64),
        reach=np.array([s.reach for s in solids], np.float64),
    )


def cast(solids: Solids, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the first solid that each ray hits.

    Args:
        origin: float64 [3]. Origin of all rays, outside every solid.
        rays: float64 [H, W, 3]. Directions of any length.

    Returns:
        t: float64 [H, W]. Distance in units of the ray; infinity without a hit.
        index: int64 [H, W]. Row of the solid; -1 without a hit.
    """
    t = np.empty(rays.shape[:2])
    index = np.empty(rays.shape[:2], np.int64)
    rays = np.ascontiguousarray(rays)
    share(_cast, len(t), solids, np.asarray(origin, np.float64), rays, t, index)
    return t, index


@kernel
def _cast(counter, solids, origin, rays, t, index):
    eye = (origin[0], origin[1], origin[2])
    row = take(counter)
    while row < len(rays):
        for col in range(rays.shape[1]):
            ray = (rays[row, col, 0], rays[row, col, 1], rays[row, col, 2])
            t[row, col], index[row, col] = nearest(solids, eye, ray, np.inf)
        row = take(counter)


@kernel
def dot(a, b):
    """Return the dot product of two vectors, tuples of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def rotate(matrix, v):
    """Return ``matrix`` [3, 3] times a vector, both as tuples of three."""
    return dot(matrix[0], v), dot(matrix[1], v), dot(matrix[2], v)


@kernel
def nearest(solids, origin, ray, limit):
    """Return the smallest t in (0, limit) at which a ray hits a solid, and its row, or -1."""
    best, which = limit, -1
    for p in range(len(solids.kind)):
        centre = solids.centre[p]
        start = (origin[0] - centre[0], origin[1] - centre[1], origin[2] - centre[2])
        along = dot(start, ray)
        beyond = dot(start, start) - solids.reach[p] ** 2
        if beyond > 0 and (along > 0 or along * along < beyond * dot(ray, ray)):
            continue
        a = solids.to_local[p]
        t = _intersect(solids.kind[p], solids.size[p], rotate(a, start), rotate(a, ray))
        if 0 < t < best:
            best, which = t, p
    return best, which


@kernel
def normal_at(kind, size, point):
    """Return the outward unit normal, in the local frame, at a local point on the surface."""
    x, y, z = point
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
    # The normal of the cone's side is tilted up by the half angle; the base faces straight down.
    side = math.hypot(2 * half, radius)
    if (z + half) * radius / side < (radius * (half - z) / (2 * half) - rho) * 2 * half / side:
        return 0.0, 0.0, -1.0
    return x / rho * 2 * half / side, y / rho * 2 * half / side, radius / side


@kernel
def _intersect(kind, size, start, ray):
    """Return the first t > 0 at which a local ray hits a solid; infinity without a hit."""
    x, y, z = start
    dx, dy, dz = ray
    lo, hi = -np.inf, np.inf
    if kind == BOX:
        for axis in range(3):
            lo, hi = _slab(start[axis], ray[axis], size[axis], lo, hi)
        return _entry(lo, hi)
    if kind == BALL:
        lo, hi = _roots(dot(ray, ray), dot(start, ray), dot(start, start) - size[0] ** 2)
        return _entry(lo, hi)
    if kind == RING:
        return _torus(size[0], size[1], start, ray)
    lo, hi = _slab(z, dz, size[1], lo, hi)
    if kind == CYLINDER:
        a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - size[0] ** 2
        if a == 0.0:
            return _entry(lo, hi) if c <= 0 else np.inf
        t0, t1 = _roots(a, b, c)
        return _entry(max(lo, t0), min(hi, t1))
    k2 = (size[0] / (2 * size[1])) ** 2
    w = size[1] - z
    a = dx * dx + dy * dy - k2 * dz * dz
    b = x * dx + y * dy + k2 * w * dz
    c = x * x + y * y - k2 * w * w
    t0, t1 = _roots(a, b, c)
    if a >= 0:
        return _entry(max(lo, t0), min(hi, t1))
    # A ray steeper than the side is inside one nappe before t0 and inside the other after t1; the
    # slab contains only the nappe below the apex.
    if t0 > t1:
        return _entry(lo, hi)
    return min(_entry(lo, min(hi, t0)), _entry(max(lo, t1), hi))


@kernel
def _slab(x, dx, half, lo, hi):
    """Clip the interval [lo, hi] of t to where |x + t dx| <= half."""
    if dx == 0.0:
        return (lo, hi) if abs(x) <= half else (np.inf, -np.inf)
    t0, t1 = (-half - x) / dx, (half - x) / dx
    return max(lo, min(t0, t1)), min(hi, max(t0, t1))


@kernel
def _entry(lo, hi):
    """Return the first positive end of an interval of t; infinity if it is empty or behind."""
    if lo > hi or hi <= 0:
        return np.inf
    return lo if lo > 0 else hi


@kernel
def _roots(a, b, c):
    """Return ordered roots of a t^2 + 2 b t + c, without cancellation; inf, -inf if none."""
    disc = b * b - a * c
    if disc < 0:
        return np.inf, -np.inf
    q = -(b + math.copysign(math.sqrt(disc), b))
    t0 = q / a
    t1 = c / q if q != 0.0 else 0.0
    return min(t0, t1), max(t0, t1)


@kernel
def _torus(ring, tube, origin, ray):
    """Find the first hit by sphere tracing (Hart, 1996): steps as long as the distance is."""
    length = math.sqrt(dot(ray, ray))
    d = (ray[0] / length, ray[1] / length, ray[2] / length)
    t, far = 0.0, ring + tube - dot(origin, d)
    for _ in range(MAX_STEPS):
        x, y, z = origin[0] + t * d[0], origin[1] + t * d[1], origin[2] + t * d[2]
        distance = math.hypot(math.hypot(x, y) - ring, z) - tube
        if distance < HIT_DISTANCE:
            return t / length
        t += distance
        if t > far:
            break
    return np.inf
