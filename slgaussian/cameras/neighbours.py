"""Which views are looked at together: those that were taken from near by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.scene import View

CHECKED = 2
"""Views, the nearest by distance, that the cameras of one are checked against."""

TURNED = 90.0
"""Degrees between two optical axes from which on two views are not looked at together."""


def neighbours(views: Sequence[View], count: int = CHECKED) -> list[tuple[int, int]]:
    """The pairs (i, j), i < j, in order, of which one is among the other's nearest views.

    The ``count`` nearest by distance of those that look the same way within :data:`TURNED`, or of
    all where none do. Where cameras stand in one place two views are no pair.
    """
    centers = np.array([view.camera.center for view in views])
    axes = np.array([view.camera.c2w[:3, 2] for view in views])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
    same_way = axes @ axes.T > np.cos(np.radians(TURNED))
    possible = apart > 1e-9 * max(float(np.abs(centers).max()), 1e-12)
    pairs = set()
    for i in range(len(views)):
        others = np.flatnonzero(possible[i] & same_way[i])
        if not len(others):
            others = np.flatnonzero(possible[i])
        nearest = others[np.argsort(apart[i, others], kind="stable")][:count]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in nearest}
    return sorted(pairs)
