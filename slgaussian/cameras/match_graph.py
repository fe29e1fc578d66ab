"""Keypoint matches of a set of views, computed once.

Checks of given cameras, selection of source views, depth ranges and quality read the same graph.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.cameras.matches import LOWE_RATIO, match, sift
from slgaussian.io import short_repr
from slgaussian.scene import ROUNDING, Sample, View

NEIGHBOURS = 6
"""Number of nearest views, by camera distance, with which each view is matched."""

MAX_AXIS_ANGLE = 90.0
"""Angle between two optical axes, degrees, from which on two views are not matched."""

Matches = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]
"""Indices int [M] and int [M] of the matching keypoints of pairs of views (i, j), i < j."""

Verified = tuple[Matches, Mapping[tuple[int, int], str]]
"""Matches that fit the poses of their views and have parallax; and why other pairs have none."""


@dataclass(frozen=True, eq=False)
class MatchGraph:
    """Keypoints of views, and matches of the pairs of views that may overlap.

    Attributes:
        keypoints: sequence of V float64 [N, 2]. Pixels, pixel centres at +0.5.
        matches: Pairs are neighbouring cameras, and successive views, because wrong poses may
            separate views that overlap; or those that the estimation of cameras solved.
        verified: Result of :func:`slgaussian.predict.view_graph.verify`, if it is known.
    """

    keypoints: Sequence[np.ndarray]
    matches: Matches
    verified: Verified | None = None

    __repr__ = short_repr

    def select(self, views: Sequence[int]) -> MatchGraph:
        """Return the graph of some of the views, in this order."""
        place = {view: number for number, view in enumerate(views)}
        matches = {}
        for (i, j), (first, second) in self.matches.items():
            if i in place and j in place:
                a, b = place[i], place[j]
                matches[min(a, b), max(a, b)] = (first, second) if a < b else (second, first)
        return MatchGraph([self.keypoints[view] for view in views], dict(sorted(matches.items())))

    def crop(self, views: Sequence[View]) -> MatchGraph:
        """Map keypoints of whole photographs to the pixels of views of them, resized and cropped.

        Matches of what a view does not show are dropped.
        """
        keypoints, inside = [], []
        for view, points in zip(views, self.keypoints, strict=True):
            part, size = view.visible_window, np.array([view.camera.width, view.camera.height])
            corner, end = np.array([[part.left, part.top], [part.right, part.bottom]])
            keypoints.append((points - corner) * (size / (end - corner)))
            inside.append(((keypoints[-1] >= 0) & (keypoints[-1] < size)).all(1))
        matches = {}
        for (i, j), (first, second) in self.matches.items():
            shown = inside[i][first] & inside[j][second]
            matches[i, j] = first[shown], second[shown]
        return MatchGraph(keypoints, matches)

    @property
    def connects_all(self) -> bool:
        """True if a chain of pairs with matches leads from each view to each other."""
        reached, pairs = {0}, [{*pair} for pair, (first, _) in self.matches.items() if len(first)]
        for _ in self.keypoints:
            reached |= {view for pair in pairs if pair & reached for view in pair}
        return len(reached) == len(self.keypoints)

    @staticmethod
    def of(views: Sequence[View]) -> MatchGraph:
        """Detect and match the SIFT features of views."""
        features = [sift(view.grey) for view in views]
        distances = _distances(views)
        successive = {(i, i + 1) for i in range(len(views) - 1) if distances[i, i + 1] > 0}
        pairs = sorted({*neighbours(views), *successive})
        matches = {(i, j): match(features[i], features[j], LOWE_RATIO)[:2] for i, j in pairs}
        return MatchGraph([item.points for item in features], matches)

    def points(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the matching points of views i < j: float64 [M, 2] and [M, 2], pixels."""
        first, second = self.matches[i, j]
        return self.keypoints[i][first], self.keypoints[j][second]

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name, as specified in ``data_specs/matches.toml``."""
        counts = [len(first) for first, _ in self.matches.values()]
        indices = [np.stack(match, 1) for match in self.matches.values()]
        return {
            "keypoints": np.concatenate([np.zeros((0, 2)), *self.keypoints]),
            "view_ends": np.cumsum([len(points) for points in self.keypoints], dtype=np.int64),
            "pairs": np.array(list(self.matches), np.int32).reshape(-1, 2),
            "match_ends": np.cumsum(counts, dtype=np.int64),
            "matches": np.concatenate([np.zeros((0, 2), int), *indices]).astype(np.int32),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray]) -> MatchGraph:
        """Rebuild a graph from the arrays of :meth:`to_arrays`."""
        keypoints = np.split(arrays["keypoints"], arrays["view_ends"][:-1])
        matches = np.split(arrays["matches"], arrays["match_ends"][:-1])
        pairs = map(tuple, arrays["pairs"].tolist())
        split = zip(pairs, matches, strict=False)  # no pair: one empty part
        return MatchGraph(
            keypoints, {pair: (indices[:, 0], indices[:, 1]) for pair, indices in split}
        )


def match_views(sample: Sample) -> MatchGraph:
    """Return the matches of the context views of a sample, computed if they are not known."""
    return sample.matches or MatchGraph.of(sample.context)


def neighbours(views: Sequence[View], count: int = NEIGHBOURS) -> list[tuple[int, int]]:
    """Return the sorted pairs (i, j), i < j, of which one view is among the other's nearest views.

    These are the ``count`` nearest views whose optical axes differ by less than
    :data:`MAX_AXIS_ANGLE`, or the nearest of all views if there are none. Views at one position
    form no pair.
    """
    axes = np.array([view.camera.c2w[:3, 2] for view in views])
    distances = _distances(views)
    same_way = axes @ axes.T > np.cos(np.radians(MAX_AXIS_ANGLE))
    pairs = set()
    for i, from_view in enumerate(distances):
        candidates = np.flatnonzero((from_view > 0) & same_way[i])
        if not len(candidates):
            candidates = np.flatnonzero(from_view)
        nearest = candidates[np.argsort(from_view[candidates], kind="stable")][:count]
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in nearest}
    return sorted(pairs)


def _distances(views: Sequence[View]) -> np.ndarray:
    """Compute distances [V, V] of cameras in scene units, exactly 0 for equal positions."""
    centers = np.array([view.camera.center for view in views])
    distances = np.linalg.norm(centers[:, None] - centers, axis=-1)
    tolerance = ROUNDING * float(np.abs(centers).max())
    return np.where(distances > tolerance, distances, 0)
