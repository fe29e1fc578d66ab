"""Solids as implicit functions, negative inside: the reference of ray casting."""

import numpy as np
from scipy.optimize import brentq

from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, Solid


def implicit_value(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Return implicit values [...] of world points [..., 3], zero on the surface."""
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
    """Return the first t in (0, far) on the surface, by dense sampling and root finding."""
    t = np.linspace(0, far, 4001)
    values = implicit_value(solid, origin + t[:, None] * ray)
    hits = np.flatnonzero(values < 0)
    if not len(hits):
        return np.inf
    before, after = t[hits[0] - 1 : hits[0] + 1]
    return brentq(lambda t: implicit_value(solid, origin + t * ray), before, after, xtol=1e-15)
