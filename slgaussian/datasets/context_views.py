"""More context views, or fewer, around those that an index names: the same for everybody.

An index names two context views and the targets. To see what more photographs do, the targets stay
and further context views are added one by one, so that those of a smaller number are always among
those of a larger one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import Scene

NAME, VERSION = "further", 1
"""Name and version of the rule, as pages have them: within a version it chooses the same."""

WITHIN = 0.1
"""Between the two, a view is taken whose distance from all others that are taken is at least this
share of the distance of the two; nearer ones see the same."""

BEYOND = 0.25
"""The same of views that are not between the two."""

APART = 0.1
"""Least distance of a further view from each target, as that share: a target is held out, and so is
the frame of a film beside it."""

TURNED = 45.0
"""By how many degrees a further view may look away from both of the two: others see other things,
or the place from elsewhere."""


def context_of(
    scene: Scene, context: Sequence[str], targets: Sequence[str], count: int
) -> tuple[str, ...]:
    """Choose so many context views for the targets, from those that an index names.

    Fewer than are named are the first, the last and some evenly between them in the list. More are
    all that are named and further ones of the scene by the rule ``further``, version 1, whose
    lengths are shares of the distance between the first and the last that are named:

    1. No target and none within :data:`APART` of one, and none that looks more than :data:`TURNED`
       degrees away from both of the two.
    2. First of the views in the ball between the two, which has them as opposite ends: each time
       the one that is farthest from all taken ones, while that is at least :data:`WITHIN`.
    3. Then of the others that are at least :data:`BEYOND` from all taken ones: each time the one
       that is nearest to the middle between the two.
    4. Of equals the first in the scene. Photographs that cannot be read are passed over.

    Parameters
    ----------
    scene : Scene
    context, targets : sequence of str
        Names as :meth:`slgaussian.scene.Scene.find` knows them; at least two of ``context``.
    count : int
        At least 2.

    Raises
    ------
    InputError
        If a name is none of the scene's, or there are not so many views.
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
    held_out = [centers[scene.find(name)] for name in targets]  # at no distance from themselves
    left = [
        name
        for name, camera in scene.cameras.items()
        if name not in chosen_views
        and (sights @ camera.c2w[:3, 2]).max() >= np.cos(np.radians(TURNED))
        and _least_distance(centers[name], held_out) >= APART
    ]
    while len(chosen_views) < count:
        # Rounded, so that views at equal distances are equal on every machine.
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
