"""The graph of views: which are matched with which, their settled cameras and sparse matches."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slgaussian.cameras.match_graph import MatchGraph, neighbours
from slgaussian.cameras.relative import Relative
from slgaussian.errors import InputError, listed
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.pose import GATE, MIN_REFINE, refine
from slgaussian.predict.pose_refinement import settle
from slgaussian.scene import Camera, Sample, View

INLIER = 2.0
"""Distance to the refined epipolar line, pixels, up to which a match counts for the range."""

MIN_PARALLAX = 1.0
"""Motion of matches by depth, pixels (their 90th percentile), below which two views are taken for
one: the matches themselves are a few tenths of a pixel off."""

SOURCES = 4
"""Views that depth is found from at most; on a walk and a forward-facing capture two and three are
worse, and memory goes with their number."""

BELIEVED = 2
"""Views, the nearest, that one without matches is linked with."""

WELL_POSED = 0.0015
"""Distance of matches to their epipolar lines (the median, as a share of the image diagonal; a
pixel of 540x360) up to which given poses stay as they are. To adjust them is to fit noise, a turn
looks much like other depths: an exact stereo rig is turned by 0.03 degrees, which makes depths 2.1
instead of 1.7 % wrong, and in novel views of a walk and a forward-facing capture, 2 to 8 views, it
makes 0.1 dB more to 0.4 dB less."""

BEST_ANGLE = 5.0
NARROW, BROAD = 2.0, 10.0
"""Degrees between two lines of sight at which a match tells most of depth, and how fast narrower
and wider ones tell less (Yao et al. 2018, "MVSNet", section 4.1)."""


@dataclass(frozen=True, eq=False)
class Link:
    """What is known about a reference view and one of its sources before any sweep.

    Attributes
    ----------
    source : int
        Index of the source view.
    relative : Relative
        From the reference to the source, as their settled cameras say.
    sparse : float64 [M]
        Inverse depths of sparse matches in the reference.
    """

    source: int
    relative: Relative
    sparse: np.ndarray


@dataclass(frozen=True, eq=False)
class ViewGraph:
    """Views that see the same things.

    Attributes
    ----------
    cameras : V Camera
        As given, or settled where matches do not meet under those.
    links : V sequences of Link
        The sources of each view, the best first.
    """

    cameras: Sequence[Camera]
    links: Sequence[Sequence[Link]]

    def closeness(self) -> np.ndarray:
        """Weights float64 [V, V] of a mean around each view; rows sum to 1.

        A view and the one that shares most matches with it count alike, others by the square of
        what they share: the exposures and poses of a walk change as one goes along.
        """
        shared = np.zeros((len(self.links), len(self.links)))
        for i, sources in enumerate(self.links):
            for link in sources:
                shared[i, link.source] = shared[link.source, i] = max(1, len(link.sparse))
        most = np.maximum(shared.max(1, keepdims=True), 1)
        weights = (shared / most) ** 2 + np.eye(len(shared))
        return weights / weights.sum(1, keepdims=True)


def link_views(views: Sequence[View], graph: MatchGraph, ranged: bool) -> ViewGraph:
    """Settle cameras that are off, and choose the sources of each view, by the matches of views.

    Views whose matches show no parallax are not linked, nothing can be learnt from them; nor are
    those with too few matches. A view that matches no other is linked with the nearest by its pose
    alone, if its depth range is given (``ranged``) or other views tell one. Where there are more
    than two, a warning says so.

    Raises
    ------
    InputError
        If a view is linked with none. Pieces of two views and more are joined by their poses.
    """
    matches, why = _matched(views, graph)
    points = graph.keypoints
    cameras = [view.camera for view in views]
    moving = {pair: found for pair, found in matches.items() if len(found[0]) >= MIN_REFINE}
    if _off(cameras, points, moving) > WELL_POSED * np.hypot(*views[0].grey.shape):
        cameras = settle(cameras, points, moving)
    found: list[list[tuple[float, Link]]] = [[] for _ in views]
    for (i, j), (p, q) in matches.items():
        _link(found, cameras, (i, j), points[i][p], points[j][q])
    if ranged or matches:
        alone = {i for i, own in enumerate(found) if not own}
        if alone and len(views) > 2:
            _warn_of([views[i].name for i in sorted(alone)])
        for i, j in neighbours(views, BELIEVED):
            if (i, j) not in why and alone & {i, j}:
                _link(found, cameras, (i, j), np.zeros((0, 2)), np.zeros((0, 2)))
    _refuse_alone(views, found, why)
    return ViewGraph(
        cameras,
        [[link for _, link in sorted(own, key=lambda one: -one[0])[:SOURCES]] for own in found],
    )


def usable(sample: Sample) -> tuple[Sample, MatchGraph, dict[str, str]]:
    """Return the sample without the context views that bring nothing, and why each is left out.

    Those are views that repeat one before them (:func:`without_doubles`), and those of
    :func:`without_strangers`. With it comes the graph of the other views.
    """
    once, doubles = without_doubles(sample)
    rest, graph, strangers = without_strangers(once, MatchGraph.of(once.context))
    return rest, graph, doubles | strangers


def without_doubles(sample: Sample) -> tuple[Sample, dict[str, str]]:
    """The sample without the context views that are one before them again, picture and place.

    Such a view would be drawn as if two had seen what one saw.
    """
    kept: list[View] = []
    left = {}
    for view in sample.context:
        same = next((one for one in kept if _same(one, view)), None)
        if same is None:
            kept.append(view)
        else:
            left[view.name] = f"it is the same picture as {same.name}, from the same place"
    return (replace(sample, context=tuple(kept)) if left else sample), left


def _same(a: View, b: View) -> bool:
    alike = np.allclose(a.camera.c2w, b.camera.c2w) and np.allclose(a.camera.K, b.camera.K)
    return bool(alike and np.array_equal(a.image, b.image))


def without_strangers(
    sample: Sample, graph: MatchGraph
) -> tuple[Sample, MatchGraph, dict[str, str]]:
    """Return the sample without the context views that match no other, and why each is left out.

    All stay where there are two, or where more than half would go. With it comes the graph of the
    views that stay.
    """
    views = sample.context
    met = {i for pair in _matched(views, graph)[0] for i in pair} if len(views) > 2 else set()
    if len(met) == len(views) or len(met) < max(3, len(views) / 2):
        return sample, graph, {}
    why = f"fewer than {MIN_MATCHES} matches with any other tell its depth"
    left = {view.name: why for i, view in enumerate(views) if i not in met}
    rest = tuple(views[i] for i in sorted(met))
    # Other views are neighbours now.
    return replace(sample, context=rest), MatchGraph.of(rest), left


Matches = dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]


def _matched(
    views: Sequence[View], graph: MatchGraph
) -> tuple[Matches, dict[tuple[int, int], str]]:
    """Which features of which pairs of views show one point, int [M] and int [M], and what is wrong
    with pairs whose matches tell no depth."""
    matches: Matches = {}
    why = {}
    for i, j in neighbours(views):
        given = Relative.between(views[i].camera, views[j].camera)
        p, q = graph.matches[i, j]
        a, b = graph.points(i, j)
        possible = np.abs(given.epipolar_distance(a, b)) < GATE * np.hypot(*views[i].grey.shape)
        p, q, a, b = (found[possible] for found in (p, q, a, b))
        there = refine(given, a, b)
        fits = np.abs(there.epipolar_distance(a, b)) < INLIER
        p, q, a, b = (found[fits] for found in (p, q, a, b))
        front = (there.triangulate(a, b) > 0) & (there.reversed().triangulate(b, a) > 0)
        if len(a) < MIN_MATCHES:
            continue
        said = _useless(views[i], views[j], there, a, b, front)
        if said is None:
            matches[i, j] = p[front], q[front]
        else:
            why[i, j] = said
    return matches, why


def _off(cameras: Sequence[Camera], points: Sequence[np.ndarray], matches: Matches) -> float:
    """Median distance of the matches to their epipolar lines, pixels; 0 without any."""
    off = [
        np.abs(
            Relative.between(cameras[i], cameras[j]).epipolar_distance(points[i][p], points[j][q])
        )
        for (i, j), (p, q) in matches.items()
    ]
    return float(np.median(np.concatenate(off))) if off else 0.0


def _useless(
    a: View, b: View, there: Relative, at_a: np.ndarray, at_b: np.ndarray, front: np.ndarray
) -> str | None:
    """Why many matches of two views tell no depth, None if they do."""
    both = f"{a.name!r} and {b.name!r}"
    motion = np.abs(there.triangulate(at_a, at_b)) * there.parallax(at_a)
    if np.percentile(motion, 90) < MIN_PARALLAX:
        return (
            f"{both} were taken from almost the same place: their {len(at_a)} matches show "
            f"{np.median(motion):.2g} pixels of parallax, but depth takes "
            f"{MIN_PARALLAX:g} or more; choose photographs taken farther apart"
        )
    if front.mean() < 0.5:
        return (
            f"{both}: by their poses, {(~front).sum()} of their {len(at_a)} matches lie "
            "behind the cameras; check that no two photographs are exchanged, and that "
            "poses are camera-to-world and follow the axes of their file format"
        )
    return None


def _link(
    found: list[list[tuple[float, Link]]],
    cameras: Sequence[Camera],
    pair: tuple[int, int],
    at_a: np.ndarray,
    at_b: np.ndarray,
) -> None:
    """Link two views both ways, each with how much it tells of depth."""
    i, j = pair
    forth = Relative.between(cameras[i], cameras[j])
    back = forth.reversed()
    here, there = forth.triangulate(at_a, at_b), back.triangulate(at_b, at_a)
    fits = np.abs(forth.epipolar_distance(at_a, at_b)) < INLIER
    good = fits & (here > 0) & (there > 0)
    angle = np.degrees(np.arctan(here * forth.parallax(at_a) / cameras[j].K[0, 0]))[good]
    wide = np.where(angle < BEST_ANGLE, NARROW, BROAD)
    worth = float(np.exp(-0.5 * ((angle - BEST_ANGLE) / wide) ** 2).sum())
    found[i].append((worth, Link(j, forth, here[good])))
    found[j].append((worth, Link(i, back, there[good])))


def _warn_of(names: Sequence[str]) -> None:
    warnings.warn(
        f"{listed([names])}: fewer than {MIN_MATCHES} matches with any other view tell the depth, "
        "which the given poses alone must find; leave out what shows another place "
        "(slgaussian.predict.view_graph.usable)",
        stacklevel=4,
    )


def _refuse_alone(
    views: Sequence[View],
    found: Sequence[Sequence[tuple[float, Link]]],
    why: dict[tuple[int, int], str],
) -> None:
    """Raise InputError if a view is linked with none."""
    alone = {i for i, own in enumerate(found) if not own}
    for pair, said in why.items():
        if alone & {*pair}:
            raise InputError(said)
    if alone:
        names = listed([views[i].name] for i in sorted(alone))
        raise InputError(
            f"views do not overlap or have too little texture: {names} has fewer than "
            f"{MIN_MATCHES} matches with any other; leave out what shows something else, "
            "choose views that overlap, or give near and far"
        )
