"""Which views are looked at together: those that were taken from near by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.scene import View

NEIGHBOURS = 2
"""Views that one is matched with, the nearest by baseline."""


def neighbours(views: Sequence[View]) -> list[tuple[int, int]]:
    """The pairs (i, j), i < j, in order, of which one is among the other's nearest views."""
    sources = [nearest(views, i) for i in range(len(views))]
    return sorted({(min(i, j), max(i, j)) for i, js in enumerate(sources) for j in js})


def nearest(views: Sequence[View], i: int) -> list[int]:
    """The :data:`NEIGHBOURS` views that are nearest to view ``i``, by distance."""
    center = views[i].camera.center
    others = [j for j in range(len(views)) if j != i]
    others.sort(key=lambda j: float(np.linalg.norm(views[j].camera.center - center)))
    return others[:NEIGHBOURS]
