"""Which views are looked at together: those taken from near by, or one after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.scene import View

TRIED = 6
"""Views, the nearest by distance, that each is matched with."""

TURNED = 90.0
"""Degrees between two optical axes from which on two views are not looked at together."""


def neighbours(views: Sequence[View], count: int = TRIED) -> list[tuple[int, int]]:
    """The pairs (i, j), i < j, in order, of which one is among the other's nearest views.

    The ``count`` nearest by distance of those that look the same way within :data:`TURNED`, or of
    all where none do. Where cameras stand in one place two views are no pair.
    """
    axes = np.array([view.camera.c2w[:3, 2] for view in views])
    apart = _distances(views)
    same_way = axes @ axes.T > np.cos(np.radians(TURNED))
    possible = apart > 0
    pairs = set()
    for i in range(len(views)):
        others = np.flatnonzero(possible[i] & same_way[i])
        if not len(others):
            others = np.flatnonzero(possible[i])
        nearest = others[np.argsort(apart[i, others], kind="stable")][:count]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in nearest}
    return sorted(pairs)


def successive(views: Sequence[View]) -> list[tuple[int, int]]:
    """The pairs (i, i + 1), whatever their poses say, but for those that stand in one place."""
    apart = _distances(views)
    return [(i, i + 1) for i in range(len(views) - 1) if apart[i, i + 1] > 0]


def _distances(views: Sequence[View]) -> np.ndarray:
    """Distances [V, V] of cameras in scene units, 0 for those in one place."""
    centers = np.array([view.camera.center for view in views])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
    least = 1e-9 * max(float(np.abs(centers).max()), 1e-12)
    return np.where(apart > least, apart, 0)
