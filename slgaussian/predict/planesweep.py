"""The predictor ``planesweep``: Gaussians from posed photographs, without any learned weights.

A plane sweep (Collins 1996) of every view; what is left is filled, and all is lifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import Field

from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.relative import Relative
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.predict import Depths
from slgaussian.predict.background import hidden
from slgaussian.predict.configs import PlaneSweepConfig
from slgaussian.predict.cost import combine, matching_cost
from slgaussian.predict.depth_completion import (
    AGREES,
    IN_FRONT,
    cross_check,
    fill,
    fit_planes,
    weighted_median,
    without_speckles,
)
from slgaussian.predict.depth_hypotheses import (
    MIN_MATCHES,
    candidates,
    inverse_depth_range,
    visible_share,
)
from slgaussian.predict.depth_propagation import SPECKLE, Swept, lend
from slgaussian.predict.exposure import color_gains
from slgaussian.predict.fusion import blend, needed
from slgaussian.predict.pose_refinement import kept_near
from slgaussian.predict.sgm import aggregate, winners
from slgaussian.predict.unproject import unproject
from slgaussian.predict.view_graph import Link, ViewGraph, link_views
from slgaussian.scene import Sample, View

MIN_MARGIN = 0.02
"""A pixel whose best cost is not this much below all others is not answered: on a blank wall the
smoothness alone decides, and both views may agree on what it says."""

MIN_VISIBLE = 0.05
"""Least share of the image that the sweep must see in a source view."""

OPACITY_SHARED = 0.5
OPACITY_ALONE = 0.9
OPACITY_REFUTED = 0.02
"""Opacity by what is known. A surface that another view shows too is drawn once a view: no copy is
opaque, so that they blend. 0.6 costs 0.2 dB in novel views; at 0.4 more of what is behind shines
through, and 1.2 instead of 1.0 % of the pixels read a wrong object's code. What one view alone
shows must close the surface by itself. What lies in another view's free space is all but invisible.
"""


class PlaneSweep(PlaneSweepConfig):
    """Depth by plane sweep and semi-global matching, one Gaussian a context pixel and some more.

    Each view is matched against the few that tell most of its depth; what they confirm is kept, the
    rest is lent by them or filled with planes of the scene. What others draw twice already is not
    drawn again.

    Attributes
    ----------
    near, far : float or None
        Depth range along z in scene units. None takes the context camera's own, and where that
        has none either, estimates it from sparse matches between the views.
    depth_candidates : int
        Most depths that are compared, 8 to 512. A pair gets one for each pixel of motion over the
        image, and no more than that; time and memory go with their number. More than the default
        gain nothing that these are worth.
    """

    near: float | None = Field(None, gt=0)
    far: float | None = Field(None, gt=0)

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.near is not None and self.far is not None and self.near >= self.far:
            raise InputError(
                f"planesweep: near {self.near:g} must be below far {self.far:g}; correct them"
            )

    def __call__(self, sample: Sample, seed: int = 0, graph: MatchGraph | None = None) -> Gaussians:
        """Gaussians in the world frame of ``sample``.

        First one a context pixel, in the order of ``source``, but for those that show what two
        views before show already; then a few for what no view sees.
        Nothing of it is random, so ``seed`` changes nothing.

        Raises
        ------
        InputError
            If no depth range is given and too few matches are found to estimate it, if near is not
            below far, if two views see nothing in common within the range, or if matches say that
            they were taken from one place or that their poses are exchanged.
        """
        return self.counted(sample, seed, graph)[0]

    def counted(
        self, sample: Sample, seed: int = 0, graph: MatchGraph | None = None
    ) -> tuple[Gaussians, Depths]:
        """What a call gives, and how many depths were compared; raises as a call."""
        views = sample.context
        matches = graph or MatchGraph.of(views)
        linked = link_views(views, matches, all(None not in _given(self, v) for v in views))
        swept = sweep(self, sample, linked.links)
        depths = Depths(sum(len(s.steps) for s in swept), len(swept) * self.depth_candidates)
        return assemble(sample, linked, swept), depths


def assemble(sample: Sample, linked: ViewGraph, swept: Sequence[Swept]) -> Gaussians:
    """Complete the depth of all views, and draw what it shows: see :meth:`PlaneSweep.__call__`."""
    views = sample.context
    found, answered = [s.inverse_depth for s in swept], [s.answered for s in swept]
    gains = color_gains([view.image for view in views], found, answered, linked)
    exposed = [
        (view.image * np.float32(gain / 255)).clip(0, 1)
        for view, gain in zip(views, gains, strict=True)
    ]
    swept = lend(swept, exposed, linked.links)
    whole = _complete(sample, linked.links, swept)
    opacities = [_opacity(i, links, swept, whole) for i, links in enumerate(linked.links)]
    steps = [s.step for s in swept]
    colors = blend(exposed, whole, steps, linked.links)
    given = [view.camera for view in views]
    cameras = kept_near(given, linked.cameras, linked.closeness())
    shown = unproject(cameras, colors, whole, opacities)
    known = [s.known for s in swept]
    kept = np.concatenate([keep.ravel() for keep in needed(linked, whole, known, steps)])
    beyond = hidden(cameras, colors, whole, steps)
    shown, beyond = (
        part.with_arrays(guessed=np.full(len(part), part is beyond)) for part in (shown, beyond)
    )
    return Gaussians.concatenated([shown[kept], beyond])


def sweep(settings: PlaneSweep, sample: Sample, links: Sequence[Sequence[Link]]) -> list[Swept]:
    """Match every view against its sources and check the answers against each other."""
    views = sample.context
    guides = [view.grey for view in views]
    everywhere = np.concatenate([link.sparse for own in links for link in own])
    found = []
    for i, view in enumerate(views):
        low, high = depth_range(settings, sample.scene, view, links[i], everywhere)
        size = guides[i].shape
        shown, steps = choose_steps(settings, links[i], size, low, high)
        if not shown and len(views) == 2:
            raise InputError(
                f"scene {sample.scene!r}: {view.name!r} and {views[links[i][0].source].name!r} "
                f"see nothing in common between depths {1 / high:.3g} and {1 / low:.3g}; "
                "choose views that overlap, or correct near and far"
            )
        if not shown:
            middle = np.full(size, steps.mean(), np.float32)
            found.append((Swept(steps, middle, np.zeros(size, bool)), np.zeros(size)))
            continue
        index, clear = _searched(guides[i], [(guides[k.source], k.relative) for k in shown], steps)
        inverse_depth = (steps[0] + index * (steps[1] - steps[0])).astype(np.float32)
        found.append((Swept(steps, inverse_depth, clear), index))
    result = []
    for (mine, index), sources in zip(found, links, strict=True):
        agrees = np.zeros(index.shape, bool)
        for link in sources:
            other = found[link.source][0].inverse_depth
            verdict = cross_check(mine.inverse_depth, other, link.relative, mine.step)
            agrees |= verdict == AGREES
        answered = without_speckles(index, agrees & mine.answered, int(SPECKLE * index.size))
        result.append(Swept(mine.steps, mine.inverse_depth, answered))
    return result


def choose_steps(
    settings: PlaneSweep, links: Sequence[Link], size: tuple[int, int], low: float, high: float
) -> tuple[list[Link], np.ndarray]:
    """Choose the candidates of a view of ``size`` (height, width) between two inverse depths.

    The poses of many views are off by a pixel or so: with steps finer than a pixel of motion in the
    view that moves least, noise would decide what is a plane and what agrees.

    Returns
    -------
    list of Link
        Those whose source sees enough of them.
    float64 [D]
        Candidate inverse depths, ascending.
    """
    most = settings.depth_candidates
    tried = [(k, candidates(k.relative, size, low, high, most)) for k in links]
    shown = [one for one in tried if visible_share(one[0].relative, size, one[1]) > MIN_VISIBLE]
    return [k for k, _ in shown], min((steps for _, steps in shown or tried), key=len)


def _searched(
    guide: np.ndarray, sources: Sequence[tuple[np.ndarray, Relative]], steps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the candidate that every pixel matches best, float32 [H, W], and where that is clear,
    bool."""
    costs = [matching_cost(guide, grey, relative, steps) for grey, relative in sources]
    best, offset, margin = winners(aggregate(combine(costs), guide))
    return best + offset, margin > MIN_MARGIN


def _given(settings: PlaneSweep, view: View) -> tuple[float | None, float | None]:
    """Near and far of a view as somebody said them."""
    return (
        settings.near if settings.near is not None else view.camera.near,
        settings.far if settings.far is not None else view.camera.far,
    )


def depth_range(
    settings: PlaneSweep, scene: str, view: View, links: Sequence[Link], everywhere: np.ndarray
) -> tuple[float, float]:
    """Least and greatest inverse depth to try for one view.

    ``everywhere`` are the sparse inverse depths of all views, for one that has too few.
    """
    near, far = _given(settings, view)
    low = high = 0.0
    if near is None or far is None:
        sparse = np.concatenate([link.sparse for link in links])
        if len(sparse) < MIN_MATCHES:
            sparse = everywhere
        if len(sparse) < MIN_MATCHES:
            raise InputError(
                f"scene {scene!r}: views do not overlap or have too little texture around "
                f"{view.name!r} ({len(sparse)} matches, {MIN_MATCHES} needed to find the depth "
                "range); choose other views, or give near and far"
            )
        baseline = min(float(np.linalg.norm(link.relative.t)) for link in links)
        low, high = inverse_depth_range(sparse, baseline)
    low = low if far is None else 1 / far
    high = high if near is None else 1 / near
    if low >= high:
        raise InputError(
            f"scene {scene!r}: for {view.name!r} near {1 / high:.3g} is not below far "
            f"{1 / low:.3g}; give both near and far"
        )
    return low, high


def _complete(
    sample: Sample, links: Sequence[Sequence[Link]], swept: Sequence[Swept]
) -> list[np.ndarray]:
    """Inverse depth float32 [H, W] of every view at every pixel."""
    whole = []
    for i, (view, mine) in enumerate(zip(sample.context, swept, strict=True)):
        planes = fit_planes(mine.inverse_depth, mine.answered, mine.step)
        witnesses = [(link.relative, swept[link.source].known) for link in links[i]]
        keep = mine.answered if mine.given is None else mine.answered | mine.given
        filled = fill(mine.inverse_depth, keep, view.grey, planes, mine.steps, witnesses)
        whole.append(weighted_median(filled, view.image, mine.steps[0], mine.step))
    return whole


def _opacity(
    i: int, links: Sequence[Link], swept: Sequence[Swept], whole: Sequence[np.ndarray]
) -> np.ndarray:
    """Opacity float32 [H, W] of view ``i``."""
    mine = swept[i]
    refuted = np.zeros(mine.answered.shape, bool)
    doubled = np.zeros(mine.answered.shape, bool)
    for link in links:
        known = swept[link.source].known
        refuted |= cross_check(whole[i], known, link.relative, mine.step) == IN_FRONT
        shown = cross_check(whole[i], whole[link.source], link.relative, mine.step)
        doubled |= (shown == AGREES) | (shown == IN_FRONT)
    cases = [mine.answered, refuted, doubled]
    values = [OPACITY_SHARED, OPACITY_REFUTED, OPACITY_SHARED]
    return np.select(cases, values, OPACITY_ALONE).astype(np.float32)
