"""Ranking of candidate answers: single objects, wholes of several, or all near-best objects.

Photographs are over-segmented, and a part of an object often does not look like the object. The
candidates of an answer are therefore the nodes of trees over the objects (like the parts, objects
and groups of SAM), and the set of all objects that fit about as well as the best, for surfaces and
plurals. The features of a candidate describe how well its objects and those around it fit, the
evidence of an image classifier, and whether it is a whole: enclosed by strong borders, persistent
in the trees, visible in all views, not cut off by the image edge. A :class:`Ranking` weights them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np

from slgaussian.io import short_repr
from slgaussian.language.rules import NEAR_BEST

MIN_SHARE = 3e-4
"""Smallest area of a candidate, as a fraction of the views: small nodes fit by chance."""

MIN_PIXELS = 30
"""Smallest area of a candidate in the queried view, pixels."""

MIN_BEST_GAP = 0.03
"""Lower bound of the best gap, by which gaps are divided."""

EVIDENCE_BOUNDS = (-3.0, 6.0)
"""Bounds of the evidence for an object, nats."""

UNSEEN_GAP = -0.2
"""Gap of an object that no view shows, in the mean of a whole."""


class Ranking(NamedTuple):
    """Weights of the features of a candidate.

    Attributes:
        fit, around: Mean gap of its objects, and of the adjacent objects weighted by length of
            border, relative to the best gap; at least -2.
        lead: Mean gap of its objects, not relative.
        recall: Its fraction of all positive gaps, summed over pixels.
        best: 1 if it contains the best object.
        near_best: 1 if it is the set of all near-best objects.
        evidence, evidence_recall: Mean class evidence of its objects, in nats, and ``recall`` for
            class evidence.
        size: Logarithm of its fraction of the photographs.
        outline: Mean strength of its border.
        edge: Fraction of its outline along the image edges.
        standing: Persistence: difference of merge costs between its creation and its next merge,
            mean over the trees.
        agreement: Ratio of its smallest to its largest area over the photographs.
    """

    fit: float
    around: float
    lead: float
    recall: float
    best: float
    near_best: float
    evidence: float
    evidence_recall: float
    size: float
    outline: float
    edge: float
    standing: float
    agreement: float


class Candidates(NamedTuple):
    """Candidate answers to Q texts: G sets of objects each.

    Attributes:
        features: float64 [Q, G, 13]. In the order of :class:`Ranking`.
        objects: bool [Q, G, N]
        possible: bool [Q, G]. True if enough of the set is visible.
    """

    features: np.ndarray
    objects: np.ndarray
    possible: np.ndarray

    def best(self, ranking: Ranking) -> np.ndarray:
        """Return the objects of each text's best set, bool [Q, N]; empty if no set is visible."""
        scores = np.einsum("qgf,f->qg", self.features, np.array(ranking))
        scores[~self.possible] = -np.inf
        winners: np.ndarray = self.objects[np.arange(len(scores)), scores.argmax(1)]
        return winners & self.possible.any(1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Wholes:
    """N objects, W wholes of several objects, and the borders between objects.

    Attributes:
        members: bool [W, N]. Objects of each whole, at least two.
        standing: float32 [N + W]. Persistence of objects, then wholes; see :class:`Ranking`.
        shares: float32 [N, V]. Fraction of the pixels of each view that show the object.
        at_edge: float32 [N]. Pixels of each object along the image edges, over all views.
        borders: int32 [E, 2]. Rows of adjacent objects, the lower first.
        border_sums: float32 [E, 2]. Length in pixels and summed strength, over all views.
    """

    members: np.ndarray
    standing: np.ndarray
    shares: np.ndarray
    at_edge: np.ndarray
    borders: np.ndarray
    border_sums: np.ndarray

    __repr__ = short_repr

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays as they are stored in ``bank.npz``, each as ``whole_NAME``."""
        return {f"whole_{f.name}": getattr(self, f.name) for f in fields(self)}

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray]) -> Wholes | None:
        """Remove the arrays of :meth:`to_arrays` from ``arrays`` and use them; None if missing."""
        if "whole_members" not in arrays:
            return None
        return Wholes(**{f.name: arrays.pop(f"whole_{f.name}") for f in fields(Wholes)})

    def candidates(
        self, gaps: np.ndarray, evidence: np.ndarray, areas: np.ndarray, share: float = NEAR_BEST
    ) -> Candidates:
        """Compute the candidate answers to Q texts.

        Args:
            gaps: float64 [Q, N]. Gaps of the objects, without class evidence; -inf excludes an
                object.
            evidence: float64 [Q, N, V]. Evidence for the classes of the texts, in nats; NaN where a
                view does not show an object, 0 for a text without classes.
            areas: int64 [N]. Pixels of each object in the queried view.
            share: See :func:`near_best`.
        """
        known = gaps > -np.inf
        visible = known & (areas > 0)
        top = gaps.max(1, where=visible, initial=MIN_BEST_GAP, keepdims=True)
        finite_gaps = np.where(known, gaps, UNSEEN_GAP)
        near = near_best(gaps, top, share)
        near_visible = near & visible
        best = np.eye(len(areas))[np.where(visible, gaps, -np.inf).argmax(1)]
        evidence = np.nan_to_num(evidence * self.shares).mean(2) / np.maximum(self._area, 1e-12)
        evidence = np.clip(evidence, *EVIDENCE_BOUNDS)

        def recall(sets: np.ndarray, values: np.ndarray) -> np.ndarray:
            fits = self._area * np.maximum(values, 0) * visible
            return _sum_members(sets, fits) / np.maximum(fits.sum(1, keepdims=True), 1e-12)

        def describe(sets: np.ndarray, numbers: np.ndarray, around: np.ndarray) -> np.ndarray:
            """Compute the features [Q, G, 13] of sets [1 or Q, G, N]."""
            size, outline, edge, agreement, standing = np.moveaxis(numbers, 2, 0)
            mean = _sum_members(sets, self._area * finite_gaps) / np.exp(size)
            shared = _sum_members(sets, near_visible)
            all_near = shared == near_visible.sum(1, keepdims=True)
            features: dict[str, np.ndarray] = {
                "fit": np.maximum(mean / top, -2),
                "around": np.maximum(_sum_members(around, finite_gaps) / top, -2),
                "lead": mean,
                "recall": recall(sets, finite_gaps),
                "best": _sum_members(sets, best),
                "near_best": all_near & (shared == _sum_members(sets, visible)),
                "evidence": _sum_members(sets, self._area * evidence) / np.exp(size),
                "evidence_recall": recall(sets, evidence),
                "size": size,
                "outline": outline,
                "edge": edge,
                "standing": standing,
                "agreement": agreement,
            }
            ordered = [features[name] for name in Ranking._fields]
            return np.stack(np.broadcast_arrays(*ordered), 2)

        sets, numbers, around = self._candidates
        near_sets = near.astype(np.float64)
        near_numbers = self._numbers(near_sets, np.zeros(len(near)))
        near_around = self._neighbour_weights(near_sets)
        features = [
            describe(sets[None], numbers[None], around[None]),
            describe(near_sets[:, None], near_numbers[:, None], near_around[:, None]),
        ]
        possible = _sum_members(sets[None], np.where(visible, areas, 0)) >= MIN_PIXELS
        objects = np.broadcast_to(sets > 0, (len(gaps), *sets.shape))
        return Candidates(
            np.concatenate(features, 1),
            np.concatenate([objects, near[:, None]], 1) & known[:, None],
            np.concatenate([possible, near_visible.any(1, keepdims=True)], 1),
        )

    @cached_property
    def _area(self) -> np.ndarray:
        return self.shares.mean(1, dtype=np.float64)

    @cached_property
    def _border_tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Length and strength of the border of each pair of objects, float64 [N, N] each."""
        count = len(self.at_edge)
        tables = np.zeros((2, count, count))
        a, b = self.borders.T
        tables[:, a, b] = tables[:, b, a] = self.border_sums.T
        return tables[0], tables[1]

    @cached_property
    def _candidates(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Objects and wholes that are large enough: sets float64 [G, N], numbers and around."""
        sets = np.concatenate([np.eye(len(self.at_edge)), self.members])
        large = sets @ self._area >= MIN_SHARE
        sets = sets[large]
        return sets, self._numbers(sets, self.standing[large]), self._neighbour_weights(sets)

    def _numbers(self, sets: np.ndarray, standing: np.ndarray) -> np.ndarray:
        """Compute size, outline, edge, agreement and standing of sets [G, N]: float64 [G, 5]."""
        length, strength = self._border_tables
        around, strong = (
            np.einsum("gn,gn->g", table.sum(1) - _sum_rows(sets, table), sets)
            for table in (length, strength)
        )
        at_edge, in_views = sets @ self.at_edge, sets @ self.shares
        size = np.log(np.maximum(sets @ self._area, 1e-6))
        outline, edge = strong / np.maximum(around, 1), at_edge / np.maximum(around + at_edge, 1)
        agreement = in_views.min(1) / np.maximum(in_views.max(1), 1e-12)
        return np.stack([size, outline, edge, agreement, standing], 1)

    def _neighbour_weights(self, sets: np.ndarray) -> np.ndarray:
        """Weight the objects adjacent to sets by common border, normalised to sum 1: [G, N]."""
        ring = _sum_rows(sets, self._border_tables[0]) * (1 - sets)
        return ring / np.maximum(ring.sum(1, keepdims=True), 1e-9)


def near_best(gaps: np.ndarray, best: np.ndarray | float, share: float = NEAR_BEST) -> np.ndarray:
    """Select objects with a gap above 0 and at least ``share`` of the ``best``: bool [..., N]."""
    return np.asarray((gaps > 0) & (gaps >= share * best))


def _sum_members(sets: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum ``values`` [Q, N] over sets [1 or Q, G, N]; not by BLAS, which varies with threads."""
    return np.asarray(np.einsum("qgn,qn->qg", sets, values))


def _sum_rows(sets: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Sum the rows of ``table`` [N, N] over sets [G, N], as :func:`_sum_members`."""
    return np.asarray(np.einsum("gn,nm->gm", sets, table))
