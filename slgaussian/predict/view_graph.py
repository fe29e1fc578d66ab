"""The view graph: source views for each reference view, refined cameras and sparse matches."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.cameras.match_graph import MatchGraph, Verified, match_views, neighbours
from slgaussian.cameras.relative import Relative
from slgaussian.errors import InputError, join_names
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.pose_refinement import (
    MAX_EPIPOLAR_DISTANCE,
    MIN_REFINED_MATCHES,
    refine,
    refine_cameras,
)
from slgaussian.scene import Camera, Sample, View

INLIER_DISTANCE = 2.0
"""Distance to the refined epipolar line, pixels, up to which a match counts for the range."""

MIN_PARALLAX = 1.0
"""Smallest parallax of matches, pixels (90th percentile), at which two views count as separate
viewpoints: the matches themselves have errors of a few tenths of a pixel."""

MAX_SOURCES = 4
"""Largest number of source views of one reference view. On a walk and a forward-facing capture two
and three sources are worse; memory is proportional to the number."""

UNMATCHED_LINKS = 2
"""Number of nearest views that a view without matches is linked with."""

WELL_POSED_DISTANCE = 0.0015
"""Median epipolar distance of matches, as a share of the image diagonal (a pixel of 540x360), up to
which given poses are not refined. Below it, refinement fits noise, because a small rotation looks
like a change of depth: it raises the depth error of an exact stereo rig from 1.7 to 2.1 %."""

BEST_ANGLE = 5.0
NARROW_STD, BROAD_STD = 2.0, 10.0
"""Triangulation angle, degrees, with the greatest weight, and the standard deviations of the weight
for narrower and wider angles (Yao et al. 2018, "MVSNet", section 4.1)."""


@dataclass(frozen=True, eq=False)
class Link:
    """A reference view's relation to one of its source views, before the plane sweep.

    Attributes:
        source: Index of the source view.
        relative: Pose of the source relative to the reference, from the refined cameras.
        sparse: float64 [M]. Inverse depths of sparse matches in the reference.
    """

    source: int
    relative: Relative
    sparse: np.ndarray


@dataclass(frozen=True, eq=False)
class ViewGraph:
    """Views linked with the views that overlap them.

    Attributes:
        cameras: V Camera. The given cameras; refined ones where the matches contradict the given
            poses.
        links: V sequences of Link. The sources of each view, best first.
    """

    cameras: Sequence[Camera]
    links: Sequence[Sequence[Link]]

    def closeness(self) -> np.ndarray:
        """Return weights of a local mean around each view, float64 [V, V]; rows sum to 1.

        A weight is proportional to the square of the number of shared matches, because exposure and
        pose errors drift along a walk; that of the view itself is the greatest.
        """
        shared = np.zeros((len(self.links), len(self.links)))
        for i, sources in enumerate(self.links):
            for link in sources:
                shared[i, link.source] = shared[link.source, i] = max(1, len(link.sparse))
        maximum = np.maximum(shared.max(1, keepdims=True), 1)
        weights = (shared / maximum) ** 2 + np.eye(len(shared))
        return weights / weights.sum(1, keepdims=True)


def link_views(sample: Sample, ranged: bool) -> ViewGraph:
    """Refine inaccurate cameras and choose the sources of each context view from the matches.

    Pairs of views with too few matches or without parallax are not linked. A view without any
    matches is linked with the nearest views by its pose alone if its depth range is given
    (``ranged``) or other views provide one; with more than two views this emits a warning.

    Raises:
        InputError: If a view has no link.
    """
    views, graph = sample.context, match_views(sample)
    matches, rejected = graph.verified or verify(views, graph)
    points = graph.keypoints
    cameras = [view.camera for view in views]
    dense = {
        pair: indices for pair, indices in matches.items() if len(indices[0]) >= MIN_REFINED_MATCHES
    }
    distances = [np.zeros(0)]
    for (i, j), (p, q) in dense.items():
        relative = Relative.between(cameras[i], cameras[j])
        distances.append(np.abs(relative.epipolar_distance(points[i][p], points[j][q])))
    if dense and np.median(np.concatenate(distances)) > WELL_POSED_DISTANCE * np.hypot(
        *views[0].grey.shape
    ):
        cameras = refine_cameras(cameras, points, dense)
    scored_links: list[list[tuple[float, Link]]] = [[] for _ in views]
    for (i, j), (p, q) in matches.items():
        _link(scored_links, cameras, i, j, points[i][p], points[j][q])
    unlinked = {i for i, sources in enumerate(scored_links) if not sources}
    if ranged or matches:
        if unlinked and len(views) > 2:
            names = join_names([[views[i].name for i in sorted(unlinked)]])
            warnings.warn(
                f"{names}: fewer than {MIN_MATCHES} matches with any other view tell the depth, "
                "which the given poses alone must find; leave out what shows another place "
                "(slgaussian.build.select_usable)",
                stacklevel=3,
            )
        for i, j in neighbours(views, UNMATCHED_LINKS):
            if (i, j) not in rejected and unlinked & {i, j}:
                _link(scored_links, cameras, i, j, np.zeros((0, 2)), np.zeros((0, 2)))
        unlinked = {i for i, sources in enumerate(scored_links) if not sources}
    for pair, reason in rejected.items():
        if unlinked & {*pair}:
            raise InputError(reason)
    if unlinked:
        raise InputError(
            "views do not overlap or have too little texture: "
            f"{join_names([views[i].name] for i in sorted(unlinked))} has fewer than {MIN_MATCHES} "
            "matches with any other; leave out what shows something else, choose views that "
            "overlap, or give near and far"
        )
    best = [sorted(sources, key=lambda scored: -scored[0]) for sources in scored_links]
    return ViewGraph(cameras, [[link for _, link in sources[:MAX_SOURCES]] for sources in best])


def verify(views: Sequence[View], graph: MatchGraph) -> Verified:
    """Return the matches of every pair that fit its poses and have parallax, and why others do not.

    Pairs are neighbouring cameras of the graph.
    """
    matches, rejected = {}, {}
    for i, j in sorted(graph.matches.keys() & {*neighbours(views)}):
        initial = Relative.between(views[i].camera, views[j].camera)
        p, q = graph.matches[i, j]
        a, b = graph.points(i, j)
        possible = np.abs(initial.epipolar_distance(a, b)) < MAX_EPIPOLAR_DISTANCE * np.hypot(
            *views[i].grey.shape
        )
        relative = refine(initial, a[possible], b[possible])
        fits = possible & (np.abs(relative.epipolar_distance(a, b)) < INLIER_DISTANCE)
        p, q, a, b = (array[fits] for array in (p, q, a, b))
        front = (relative.triangulate(a, b) > 0) & (relative.reverse().triangulate(b, a) > 0)
        if len(a) < MIN_MATCHES:
            continue
        reason = _rejection_reason(views[i], views[j], relative, a, b, front)
        if reason is None:
            matches[i, j] = p[front], q[front]
        else:
            rejected[i, j] = reason
    return matches, rejected


def _rejection_reason(
    a: View, b: View, relative: Relative, at_a: np.ndarray, at_b: np.ndarray, front: np.ndarray
) -> str | None:
    """Return why the matches of two views determine no depth, None if they do."""
    names = f"{a.name!r} and {b.name!r}"
    motion = np.abs(relative.triangulate(at_a, at_b)) * relative.parallax(at_a)
    if np.percentile(motion, 90) < MIN_PARALLAX:
        return (
            f"{names} were taken from almost the same place: their {len(at_a)} matches show "
            f"{np.median(motion):.2g} pixels of parallax, but depth takes "
            f"{MIN_PARALLAX:g} or more; choose photographs taken farther apart"
        )
    if front.mean() < 0.5:
        return (
            f"{names}: by their poses, {(~front).sum()} of their {len(at_a)} matches lie "
            "behind the cameras; check that no two photographs are exchanged, and that "
            "poses are camera-to-world and follow the axes of their file format"
        )
    return None


def _link(
    scored_links: list[list[tuple[float, Link]]],
    cameras: Sequence[Camera],
    i: int,
    j: int,
    at_a: np.ndarray,
    at_b: np.ndarray,
) -> None:
    """Link two views in both directions, each link with the sum of its matches' angle weights."""
    forth = Relative.between(cameras[i], cameras[j])
    back = forth.reverse()
    depth_a, depth_b = forth.triangulate(at_a, at_b), back.triangulate(at_b, at_a)
    fits = np.abs(forth.epipolar_distance(at_a, at_b)) < INLIER_DISTANCE
    good = fits & (depth_a > 0) & (depth_b > 0)
    angle = np.degrees(np.arctan(depth_a * forth.parallax(at_a) / cameras[j].K[0, 0]))[good]
    wide = np.where(angle < BEST_ANGLE, NARROW_STD, BROAD_STD)
    worth = float(np.exp(-0.5 * ((angle - BEST_ANGLE) / wide) ** 2).sum())
    scored_links[i].append((worth, Link(j, forth, depth_a[good])))
    scored_links[j].append((worth, Link(i, back, depth_b[good])))
