"""Which views are matched with which, their refined geometry and their sparse matches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.cameras.matches import sift_matches
from slgaussian.cameras.neighbours import nearest, neighbours
from slgaussian.cameras.relative import Relative
from slgaussian.errors import InputError
from slgaussian.predict.candidates import MIN_MATCHES
from slgaussian.predict.pose import GATE, refine
from slgaussian.scene import View

INLIER = 2.0
"""Distance to the refined epipolar line, pixels, up to which a match counts for the range."""


MIN_PARALLAX = 1.0
"""Motion of matches by depth, pixels (their 90th percentile), below which two views are taken for
one: the matches themselves are a few tenths of a pixel off."""


@dataclass(frozen=True, eq=False)
class Link:
    """What is known about a reference view and one of its sources before any sweep.

    Attributes
    ----------
    source : int
        Index of the source view.
    relative : Relative
        From the reference to the source, refined for matching.
    sparse : float64 [M]
        Inverse depths of sparse matches in the reference.
    """

    source: int
    relative: Relative
    sparse: np.ndarray


def link_views(views: Sequence[View]) -> list[list[Link]]:
    """For each view, links to its nearest views in order of distance.

    As many as :data:`slgaussian.cameras.neighbours.NEIGHBOURS`. Two views whose matches show no
    parallax are not linked: nothing can be learnt from them.

    Raises
    ------
    InputError
        If that leaves a view without a link, or if most matches of two views would lie behind the
        cameras.
    """
    greys = [view.grey for view in views]
    sources = [nearest(views, i) for i in range(len(views))]
    links: dict[tuple[int, int], Link] = {}
    too_close: dict[int, str] = {}
    for i, j in neighbours(views):
        given = Relative.between(views[i].camera, views[j].camera)
        a, b = sift_matches(greys[i], greys[j])
        possible = np.abs(given.epipolar_distance(a, b)) < GATE * np.hypot(*greys[i].shape)
        a, b = a[possible], b[possible]
        forth = refine(given, a, b)
        back = forth.reversed()
        fits = np.abs(forth.epipolar_distance(a, b)) < INLIER
        a, b = a[fits], b[fits]
        here, there = forth.triangulate(a, b), back.triangulate(b, a)
        front = (here > 0) & (there > 0)
        if len(a) >= MIN_MATCHES:
            both = f"{views[i].name!r} and {views[j].name!r}"
            motion = np.abs(here) * forth.parallax(a)
            if np.percentile(motion, 90) < MIN_PARALLAX:
                too_close[i] = too_close[j] = (
                    f"{both} were taken from almost the same place: their {len(a)} matches show "
                    f"{np.median(motion):.2g} pixels of parallax, but depth takes "
                    f"{MIN_PARALLAX:g} or more; choose photographs taken farther apart"
                )
                continue
            if front.mean() < 0.5:
                raise InputError(
                    f"{both}: by their poses, {(~front).sum()} of their {len(a)} matches lie "
                    "behind the cameras; check that no two photographs are exchanged, and that "
                    "poses are camera-to-world and follow the axes of their file format"
                )
        links[i, j] = Link(j, forth, here[front])
        links[j, i] = Link(i, back, there[front])
    linked = [[links[i, j] for j in js if (i, j) in links] for i, js in enumerate(sources)]
    for i, found in enumerate(linked):
        if not found:
            raise InputError(too_close[i])
    return linked
