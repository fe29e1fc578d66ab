"""Lenses that the matches contradict: focal lengths of EXIF that are wrong, and distortion.

A pair is solved under each assumption on its lenses, and the evidences (the posterior integrated
over pose and lenses, by Laplace's approximation) are compared. The bounds were chosen on every
second pair of `docs/measured/poses.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import ndtr

from slgaussian.cameras.epipolar import FocalPrior, TwoViews, evidence, refine, solve, widen

EXIF_WRONG, BENT = 0.3, 0.1
"""Probabilities, before the matches are seen, that EXIF is of another field of view, and that a
lens is distorted."""

SUSPECT_WRONG, MIN_WRONG, MIN_BENT = 0.4, 0.9, 0.5
"""Smallest probabilities of wrong EXIF that is reported, and that is left out, and of a distortion
that is removed."""

BEND_STD = 0.3
"""Standard deviation of the distortion of lenses, in units of :class:`Lens`."""

SOLVED_GAIN = -1.0
"""Gain of log evidence from which on an assumption is solved from every start."""

MIN_BEND_STD = 0.02
"""Smallest standard deviation of an estimated distortion: lenses differ from the model."""

Assumption = tuple[bool, bool, bool]
"""Whether EXIF of the first and of the second lens is wrong, and whether lenses are distorted."""


@dataclass(frozen=True)
class Lens:
    """Priors of a lens; focal lengths are logarithms, with their standard deviations.

    Attributes:
        longer: Longer side of the photograph, pixels.
        exif: Focal length by EXIF; None without.
        typical: Focal length without EXIF.
        bend: Standard deviation of the distortion, Brown's k1 at a focal length of ``longer``.
        open: Whether the distortion is to be estimated.
    """

    longer: int
    exif: tuple[float, float] | None
    typical: tuple[float, float]
    bend: float = BEND_STD
    open: bool = True


@dataclass(frozen=True)
class LensEvidence:
    """Evidence of the matches of two photographs on one of their lenses.

    Attributes:
        wrong, bent: Logarithms of the Bayes factors for a wrong focal length by EXIF, and for a
            distortion.
        focal: Logarithm of the focal length without EXIF, and its standard deviation.
        bend: Distortion and its standard deviation, in units of :class:`Lens`.
    """

    wrong: float
    bent: float
    focal: tuple[float, float]
    bend: tuple[float, float]


def assume(
    lenses: tuple[Lens, Lens], shared: bool, assumption: Assumption = (False, False, False)
) -> FocalPrior:
    """Return the prior of two lenses under an assumption."""
    *wrong, bent = assumption
    focals = [
        lens.typical if lens.exif is None or off else lens.exif
        for lens, off in zip(lenses, wrong, strict=True)
    ]
    mean, sigma = np.array(focals).T
    bend = np.array([bent * lens.bend / lens.longer**2 for lens in lenses])
    return FocalPrior(mean, sigma, shared, bend)


def weigh(
    lenses: tuple[Lens, Lens], shared: bool, x: np.ndarray, y: np.ndarray, best: TwoViews
) -> tuple[tuple[LensEvidence, LensEvidence], list[tuple[float, TwoViews]]]:
    """Compare the assumptions on two lenses by the matches [M, 2] and [M, 2].

    Args:
        shared: Whether both are one lens.
        best: Best solution under the plain assumption.

    Returns:
        The evidence on the lenses, and a solution under each assumption with its probability.
    """
    exif = [lens.exif is not None for lens in lenses]
    sides = [(False, True) if some else (False,) for some in (*exif, lenses[0].open)]
    assumptions: list[Assumption] = [
        (first, second, bent)
        for first, second, bent in product(*sides)
        if not shared or first == second
    ]
    odds_wrong, odds_bent = (np.log(p / (1 - p)) for p in (EXIF_WRONG, BENT))
    ends, gains = {assumptions[0]: best}, {assumptions[0]: 0.0}
    for each in assumptions[1:]:
        prior = assume(lenses, shared, each)
        straight = ends.get((*each[:2], False), best)
        end = refine(straight, x, y, prior)
        gain = -np.inf if end is None else _gain(end, best, x, y)
        # Wrong focal lengths are often optima of their own.
        if gain > SOLVED_GAIN or not each[2]:
            for answer in solve(x, y, prior)[:1]:
                if (more := _gain(answer, best, x, y)) > gain:
                    end, gain = answer, more
        if end is not None:
            ends[each] = end
            gains[each] = (
                gain + odds_bent * each[2] + odds_wrong * (each[0] if shared else each[0] + each[1])
            )

    def factor(place: int) -> float:
        """Sum the evidences with and without an assumption."""
        split = [[gain for each, gain in gains.items() if each[place] == v] for v in (False, True)]
        without, with_it = (np.logaddexp.reduce(side) if side else -np.inf for side in split)
        return float(with_it - without - (odds_bent if place == 2 else odds_wrong))

    def likeliest(place: int) -> tuple[TwoViews, FocalPrior]:
        """Return the best solution with an assumption, if one has it, with its prior."""
        among = [each for each in gains if each[place]] or list(gains)
        each = max(among, key=gains.__getitem__)
        prior = assume(lenses, shared, (each[0], each[1], True))
        return widen(ends[each], x, y, prior), prior

    bent, bent_prior = likeliest(2)
    evidences = []
    for place in (0, 1):
        free, prior = likeliest(place)
        focal = float(np.log(free.focals[place])), float(free.deviations(prior)[0][place])
        squared = lenses[place].longer ** 2
        bend = bent.bends[place] * squared, float(bent.deviations(bent_prior)[1][place]) * squared
        evidences.append(LensEvidence(factor(place), factor(2), focal, bend))
    total = np.logaddexp.reduce(list(gains.values()))
    solutions = [(float(np.exp(gains[each] - total)), end) for each, end in ends.items()]
    return (evidences[0], evidences[1]), solutions


def _gain(views: TwoViews, plain: TwoViews, x: np.ndarray, y: np.ndarray) -> float:
    """Compute the gain of log evidence over a plain solution."""
    scale = min(views.scale, plain.scale)
    return evidence(views, x, y, scale) - evidence(plain, x, y, scale)


def combine(evidences: Sequence[LensEvidence]) -> LensEvidence:
    """Combine what several pairs say about one lens."""
    means = []
    for values in ([each.focal for each in evidences], [each.bend for each in evidences]):
        mean, std = np.array(values).T
        weight = std**-2.0
        means.append((float((weight * mean).sum() / weight.sum()), float(std.min())))
    wrong, bent = (float(sum(getattr(e, name) for e in evidences)) for name in ("wrong", "bent"))
    focal, (bend, std) = means
    if update(BENT, bent) < MIN_BENT:
        return LensEvidence(wrong, bent, focal, (0.0, BEND_STD))
    # The loss underestimates errors of matches.
    return LensEvidence(wrong, bent, focal, (bend, float(np.hypot(2 * std, MIN_BEND_STD))))


def update(prior: float, factor: float) -> float:
    """Return the probability of an assumption by its prior probability and log Bayes factor."""
    return float(1 / (1 + np.exp(-np.clip(factor + np.log(prior / (1 - prior)), -500, 500))))


def interval(components: Sequence[tuple[float, float, float]], tail: float) -> tuple[float, float]:
    """Return the quantiles ``tail`` and ``1 - tail`` of a mixture of normal distributions.

    Args:
        components: sequence of (weight, mean, standard deviation)
    """
    weight, mean, std = np.array(components).T
    ends = []
    for level in (tail, 1 - tail):
        low, high = float((mean - 8 * std).min()), float((mean + 8 * std).max())
        for _ in range(60):
            middle = (low + high) / 2
            below = (weight * ndtr((middle - mean) / std)).sum() < level
            low, high = (middle, high) if below else (low, middle)
        ends.append(low)
    return ends[0], ends[1]
