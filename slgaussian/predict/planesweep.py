"""The predictor ``planesweep``: Gaussians from posed photographs, without learned weights.

A plane sweep (Collins 1996) of every view, depth completion, fusion of the views and unprojection.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.work_sharing import share_items
from slgaussian.predict import Depths
from slgaussian.predict.background import continue_surfaces
from slgaussian.predict.configs import PlaneSweepConfig
from slgaussian.predict.cost import combine_costs, matching_costs
from slgaussian.predict.depth_completion import (
    AGREES,
    IN_FRONT,
    cross_check,
    fill_depth,
    fit_planes,
    remove_speckles,
    weighted_median,
)
from slgaussian.predict.depth_hypotheses import (
    MIN_MATCHES,
    inverse_depth_candidates,
    inverse_depth_range,
    visible_share,
)
from slgaussian.predict.depth_propagation import MAX_SPECKLE_SHARE, SweptView, propagate_depth
from slgaussian.predict.exposure import colour_gains
from slgaussian.predict.fusion import blend, select_pixels
from slgaussian.predict.pose_refinement import anchor_cameras
from slgaussian.predict.sgm import aggregate, select_winners
from slgaussian.predict.unproject import unproject
from slgaussian.predict.view_graph import Link, ViewGraph, link_views
from slgaussian.scene import Sample, View

MIN_MARGIN = 0.02
"""Smallest relative margin of the best cost at which a pixel counts as answered: on a blank wall
smoothness alone decides, and both views may agree on a wrong depth."""

MIN_VISIBLE = 0.05
"""Smallest share of the image that must be visible in a source view."""

OPACITY_SHARED = 0.5
OPACITY_ALONE = 0.9
OPACITY_REFUTED = 0.02
"""Opacities of three kinds of pixels. A surface that another view shows as well is drawn by both,
so no copy is opaque: 0.6 costs 0.2 dB in novel views; at 0.4 more of the background shines through.
A surface of one view must be closed by that view. A pixel in the free space of another view is
almost invisible."""


class PlaneSweep(PlaneSweepConfig):
    """Depth by plane sweep and semi-global matching, one Gaussian for each context pixel and more.

    Each view is matched against its best source views. Depth that a source confirms is kept;
    other pixels take propagated depth of their sources or the depth of fitted planes. A surface
    that enough earlier views draw is not drawn again. Time and memory are proportional to
    ``depth_candidates``.
    """

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Predict Gaussians in the world frame of ``sample``.

        The first are those of context pixels, in the order of ``source``, without surfaces that
        two earlier views draw; then follow those of unseen regions. The result does not depend on
        ``seed``.

        Raises:
            InputError: If a camera has no depth range and there are too few matches to estimate
                one, if near is not below far, if two views have no overlap within the range, or if
                matches show that two views have no baseline or that their poses are exchanged.
        """
        return self.predict_with_counts(sample, seed)[0]

    def predict_with_counts(self, sample: Sample, seed: int = 0) -> tuple[Gaussians, Depths]:
        """Predict as by a call, and count the depth candidates; raises as a call."""
        sample, frame = sample.localize()
        views = sample.context
        ranged = all(None not in (view.camera.near, view.camera.far) for view in views)
        linked = link_views(sample, ranged)
        swept = sweep(self, sample, linked.links)
        depths = Depths(sum(len(s.steps) for s in swept), len(swept) * self.depth_candidates)
        return assemble(sample, linked, swept).place(frame), depths


def assemble(sample: Sample, linked: ViewGraph, swept: Sequence[SweptView]) -> Gaussians:
    """Complete the depth of all views and convert it to Gaussians.

    See :meth:`PlaneSweep.__call__` for their order.
    """
    views = sample.context
    raw_depths, answered = [s.inverse_depth for s in swept], [s.answered for s in swept]
    gains = colour_gains([view.image for view in views], raw_depths, answered, linked)
    exposed = [
        (view.image * np.float32(gain / 255)).clip(0, 1)
        for view, gain in zip(views, gains, strict=True)
    ]
    swept = propagate_depth(swept, exposed, linked.links)
    depths = _complete_depths(sample, linked.links, swept)
    opacities = [_opacity(i, links, swept, depths) for i, links in enumerate(linked.links)]
    steps = [s.step for s in swept]
    colours = blend(exposed, depths, steps, linked.links)
    given_cameras = [view.camera for view in views]
    cameras = anchor_cameras(given_cameras, linked.cameras, linked.closeness())
    visible = unproject(cameras, colours, depths, opacities)
    confirmed = [s.confirmed for s in swept]
    drawn = np.ravel(select_pixels(linked, depths, confirmed, steps))
    beyond = continue_surfaces(cameras, colours, depths, steps)
    visible, beyond = (
        part.with_arrays(guessed=np.full(len(part), part is beyond)) for part in (visible, beyond)
    )
    return Gaussians.concatenate([visible[drawn], beyond])


def sweep(settings: PlaneSweep, sample: Sample, links: Sequence[Sequence[Link]]) -> list[SweptView]:
    """Match every view against its sources and cross-check the depths."""
    views = sample.context
    guides = [view.grey for view in views]
    all_sparse = np.concatenate([link.sparse for view_links in links for link in view_links])
    results = []
    for i, view in enumerate(views):
        low, high = depth_range(sample.scene, view, links[i], all_sparse)
        size = guides[i].shape
        visible, steps = choose_steps(settings, links[i], size, low, high)
        if not visible and len(views) == 2:
            raise InputError(
                f"scene {sample.scene!r}: {view.name!r} and {views[links[i][0].source].name!r} "
                f"see nothing in common between depths {1 / high:.3g} and {1 / low:.3g}; "
                "choose views that overlap, or correct near and far"
            )
        if not visible:
            middle = np.full(size, steps.mean(), np.float32)
            results.append((SweptView(steps, middle, np.zeros(size, bool)), np.zeros(size)))
            continue
        costs = matching_costs(guides[i], [(guides[k.source], k.relative) for k in visible], steps)
        best, offset, margin = select_winners(aggregate(combine_costs(costs), guides[i]))
        index, clear = best + offset, margin > MIN_MARGIN
        inverse_depth = (steps[0] + index * (steps[1] - steps[0])).astype(np.float32)
        results.append((SweptView(steps, inverse_depth, clear), index))
    result = []
    for (mine, index), sources in zip(results, links, strict=True):
        agrees = np.zeros(index.shape, bool)
        for link in sources:
            source_depth = results[link.source][0].inverse_depth
            verdict = cross_check(mine.inverse_depth, source_depth, link.relative, mine.step)
            agrees |= verdict == AGREES
        answered = remove_speckles(
            index, agrees & mine.answered, int(MAX_SPECKLE_SHARE * index.size)
        )
        result.append(SweptView(mine.steps, mine.inverse_depth, answered))
    return result


def choose_steps(
    settings: PlaneSweep, links: Sequence[Link], size: tuple[int, int], low: float, high: float
) -> tuple[list[Link], np.ndarray]:
    """Choose the candidates of a view of ``size`` (height, width) between two inverse depths.

    Of the candidates of all sources the coarsest are taken: with steps finer than the errors of the
    poses, noise would decide which depths agree.

    Returns:
        list of Link: The links whose source sees a large enough part of the view.
        float64 [D]: Candidate inverse depths, ascending.
    """
    maximum = settings.depth_candidates
    tried = [(k, inverse_depth_candidates(k.relative, size, low, high, maximum)) for k in links]
    visible = [
        pair for pair in tried if visible_share(pair[0].relative, size, pair[1]) > MIN_VISIBLE
    ]
    return [k for k, _ in visible], min((steps for _, steps in visible or tried), key=len)


def depth_range(
    scene: str, view: View, links: Sequence[Link], all_sparse: np.ndarray
) -> tuple[float, float]:
    """Return the smallest and greatest inverse depth of the sweep of one view.

    ``all_sparse`` are the sparse inverse depths of all views, used if the view has too few.
    """
    near, far = view.camera.near, view.camera.far
    low = high = 0.0
    if near is None or far is None:
        sparse = np.concatenate([link.sparse for link in links])
        if len(sparse) < MIN_MATCHES:
            sparse = all_sparse
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


def _complete_depths(
    sample: Sample, links: Sequence[Sequence[Link]], swept: Sequence[SweptView]
) -> list[np.ndarray]:
    """Complete the inverse depth of every view, V of float32 [H, W]."""

    def complete(view: View, sweep: SweptView, sources: Sequence[Link]) -> np.ndarray:
        planes = fit_planes(sweep.inverse_depth, sweep.answered, sweep.step)
        witnesses = [(link.relative, swept[link.source].confirmed) for link in sources]
        filled = fill_depth(
            sweep.inverse_depth, sweep.valid, view.grey, planes, sweep.steps, witnesses
        )
        return weighted_median(filled, view.image, sweep.steps[0], sweep.step)

    return share_items(complete, sample.context, swept, links)


def _opacity(
    i: int, links: Sequence[Link], swept: Sequence[SweptView], depths: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the opacity of the pixels of view ``i``, float32 [H, W]."""
    step, shape = swept[i].step, depths[i].shape
    refuted, doubled = np.zeros(shape, bool), np.zeros(shape, bool)
    for link in links:
        confirmed = swept[link.source].confirmed
        refuted |= cross_check(depths[i], confirmed, link.relative, step) == IN_FRONT
        verdict = cross_check(depths[i], depths[link.source], link.relative, step)
        doubled |= (verdict == AGREES) | (verdict == IN_FRONT)
    cases = [swept[i].answered, refuted, doubled]
    values = [OPACITY_SHARED, OPACITY_REFUTED, OPACITY_SHARED]
    return np.select(cases, values, OPACITY_ALONE).astype(np.float32)
