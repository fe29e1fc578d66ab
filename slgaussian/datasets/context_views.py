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

NAME, VERSION = "further", 1
"""Name and version of the rule in reports; the selection is constant within a version."""

WITHIN = 0.1
"""Smallest distance between a view added between the two and all selected views, as a fraction of
the distance of the two; nearer views are redundant."""

BEYOND = 0.25
"""The same for views that are not between the two."""

APART = 0.1
"""Smallest distance of an added view from each target, as the same fraction: a target is held out,
and so are its neighbours in a film."""

TURNED = 45.0
"""Largest angle, degrees, between the optical axis of an added view and the nearer of the two."""


def context_of(
    scene: Scene, context: Sequence[str], targets: Sequence[str], count: int
) -> tuple[str, ...]:
    """Choose ``count`` context views for the targets, starting from those of an index.

    Fewer than listed: the first, the last and some evenly between them in the list. More: all
    listed views, and further views of the scene by the rule ``further``, version 1. Its distances
    are fractions of the distance between the first and the last listed view, "the two":

    1. Excluded are targets, views within :data:`APART` of a target, and views whose optical axis
       deviates by more than :data:`TURNED` degrees from both of the two.
    2. First, among the views in the sphere with the two as poles: repeatedly the view farthest from
       all selected ones, while that distance is at least :data:`WITHIN`.
    3. Then, among views at least :data:`BEYOND` from all selected ones: repeatedly the view nearest
       to the midpoint of the two.
    4. Ties go to the first view in the scene. Photographs that cannot be read are skipped.

    Args:
        context, targets: sequence of str. Names as accepted by :meth:`slgaussian.scene.Scene.find`;
            at least two in ``context``.
        count: At least 2.

    Raises:
        InputError: If a name does not exist in the scene, or there are not enough views.
    """
    chosen_views = [scene.find(name) for name in context]
    if count <= len(chosen_views):
        places = [round(i * (len(chosen_views) - 1) / (count - 1)) for i in range(count)]
        return tuple(chosen_views[place] for place in places)
    first, last = (scene.cameras[name] for name in (chosen_views[0], chosen_views[-1]))
    baseline = max(float(np.linalg.norm(first.center - last.center)), 1e-12)
    middle = (first.center + last.center) / 2
    sights = np.stack([first.c2w[:3, 2], last.c2w[:3, 2]])
    centers = {name: (c.center - middle) / baseline for name, c in scene.cameras.items()}
    held_out = [centers[scene.find(name)] for name in targets]  # at distance 0 from themselves
    left = [
        name
        for name, camera in scene.cameras.items()
        if name not in chosen_views
        and (sights @ camera.c2w[:3, 2]).max() >= np.cos(np.radians(TURNED))
        and _least_distance(centers[name], held_out) >= APART
    ]
    while len(chosen_views) < count:
        # Distances are rounded, so that ties are resolved equally on every machine.
        radii = {name: round(float(np.linalg.norm(centers[name])), 6) for name in left}
        chosen_centers = [centers[name] for name in chosen_views]
        gaps = {name: round(_least_distance(centers[name], chosen_centers), 6) for name in left}
        within = [name for name in left if radii[name] <= 0.5 and gaps[name] >= WITHIN]
        beyond = [name for name in left if radii[name] > 0.5 and gaps[name] >= BEYOND]
        if not (within or beyond):
            raise InputError(
                f"scene {scene.name!r}: found {len(chosen_views)} context views around its "
                f"targets, expected {count}; ask for fewer, or add photographs"
            )
        chosen = max(within, key=gaps.__getitem__) if within else min(beyond, key=radii.__getitem__)
        left.remove(chosen)
        try:
            scene.read(chosen)
        except InputError:
            continue
        chosen_views.append(chosen)
    return tuple(chosen_views)


def _least_distance(place: np.ndarray, centers: Sequence[np.ndarray]) -> float:
    return min((float(np.linalg.norm(place - center)) for center in centers), default=np.inf)
