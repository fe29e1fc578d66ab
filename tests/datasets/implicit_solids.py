"""Solids as implicit functions, negative inside: the plain formulas that ray casting must obey."""

import numpy as np

from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, Solid


def inside_below_zero(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Implicit function [...] of world points [..., 3]; its zero set is the solid's surface."""
    p = (points - np.asarray(solid.centre)) @ solid.rotation
    size = solid.size
    rho = np.hypot(p[..., 0], p[..., 1])
    if solid.kind == BOX:
        return (np.abs(p) - size).max(-1)
    if solid.kind == BALL:
        return np.linalg.norm(p, axis=-1) - size[0]
    if solid.kind == CYLINDER:
        return np.maximum(rho - size[0], np.abs(p[..., 2]) - size[1])
    if solid.kind == CONE:
        side = rho - size[0] * (size[1] - p[..., 2]) / (2 * size[1])
        return np.maximum(side, np.abs(p[..., 2]) - size[1])
    return np.hypot(rho - size[0], p[..., 2]) - size[1]


def first_crossing(solid: Solid, origin: np.ndarray, ray: np.ndarray, far: float) -> float:
    """First t in (0, far) at which a ray enters the solid, by dense sampling and bisection."""
    t = np.linspace(0, far, 4001)
    values = inside_below_zero(solid, origin + t[:, None] * ray)
    hits = np.flatnonzero(values < 0)
    if not len(hits):
        return np.inf
    lo, hi = t[hits[0] - 1], t[hits[0]]
    for _ in range(60):
        middle = (lo + hi) / 2
        if inside_below_zero(solid, origin + middle * ray) < 0:
            hi = middle
        else:
            lo = middle
    return hi
