"""Selection of more or fewer context views than an evaluation index lists, by a fixed rule.

An index lists two context views and the targets. To measure the effect of more photographs, the
targets are fixed and context views are added one by one, so that a smaller set is always a subset
of a larger one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import Scene

MIN_INNER_DISTANCE = 0.1
"""Smallest distance between a view added between the two and all selected views, as a fraction of
the distance of the two; nearer views are redundant."""

MIN_OUTER_DISTANCE = 0.25  # the same for views that are not between the two

MIN_TARGET_DISTANCE = 0.1
"""Smallest distance of an added view from each target, as the same fraction: a target is held out,
and so are its neighbours in a film."""

MAX_AXIS_ANGLE = 45.0
"""Largest angle, degrees, between the optical axis of an added view and the nearer of the two."""


def choose_context(
    scene: Scene, context: Sequence[str], targets: Sequence[str], count: int
) -> tuple[str, ...]:
    """Choose ``count`` context views for the targets, starting from those of an index.

    Fewer than listed: the first, the last and some evenly between them in the list. More: all
    listed views, and further views by the rule ``further``, version 1, of docs/guides/datasets.md.
    Its distances are fractions of that between the first and the last listed view.

    Args:
        context, targets: sequence of str. Names as accepted by :meth:`slgaussian.scene.Scene.find`;
            at least two in ``context``.
        count: At least 2.

    Raises:
        InputError: If a name does not exist in the scene, or there are not enough views.
    """
    names = list(scene.cameras)
    chosen, held_out = (
        [names.index(scene.find(name)) for name in group] for group in (context, targets)
    )
    if count <= len(chosen):
        places = [round(i * (len(chosen) - 1) / (count - 1)) for i in range(count)]
        return tuple(names[chosen[place]] for place in places)
    axes = np.stack([camera.c2w[:3, 2] for camera in scene.cameras.values()])
    centers = np.stack([camera.center for camera in scene.cameras.values()])
    first, last = centers[[chosen[0], chosen[-1]]]
    centers = (centers - (first + last) / 2) / max(float(np.linalg.norm(first - last)), 1e-12)
    # Distances are rounded, so that ties are resolved equally on every machine.
    radii = np.linalg.norm(centers, axis=1).round(6)

    def distances(views: Sequence[int]) -> np.ndarray:
        to_views = np.linalg.norm(centers[:, None] - centers[views], axis=-1)
        return to_views.min(1, initial=np.inf)

    free = (axes @ axes[[chosen[0], chosen[-1]]].T).max(1) >= np.cos(np.radians(MAX_AXIS_ANGLE))
    free &= distances(held_out) >= MIN_TARGET_DISTANCE
    free[chosen] = False
    while len(chosen) < count:
        gaps = distances(chosen).round(6)
        within = free & (radii <= 0.5) & (gaps >= MIN_INNER_DISTANCE)
        beyond = free & (radii > 0.5) & (gaps >= MIN_OUTER_DISTANCE)
        if not (within | beyond).any():
            raise InputError(
                f"scene {scene.name!r}: found {len(chosen)} context views around its targets, "
                f"expected {count}; ask for fewer, or add photographs"
            )
        inner, outer = np.where(within, gaps, -1), np.where(beyond, radii, np.inf)
        view = int(inner.argmax() if within.any() else outer.argmin())
        free[view] = False
        try:
            scene.read(names[view])
        except InputError:
            continue
        chosen.append(view)
    return tuple(names[view] for view in chosen)
