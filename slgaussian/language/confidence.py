"""The probability that an answer is right, from how its objects stand out of the rest of the view.

A score says how well a text fits the best object, not whether that is the thing: in every view
something fits best. Four numbers tell right answers from others:

- the *evidence* for the best object. A gap is a mean over all that a text asks for, and a high mean
  of few measurements is chance more easily than one of many; so it is summed up: the gap times the
  number of measurements, as a naive Bayes classifier adds up log odds;
- how many standard deviations the objects of the answer *stand out* of those of the rest;
- of how many *parts* that do not touch the answer is made. What was only best by chance lies
  scattered;
- by how much some object of the scene is *named* so by the classifier, where the noun is one of its
  classes: it tells best what is not there.

A logistic curve makes probabilities of them, whose constants an encoder brings along, as its
cosines have a scale of their own.

``benches/language/answer_confidence.py`` fits the constants, and says how they do at places that
they were not fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

EVEN_OUT = 0.02
"""Added to the standard deviation of the rest, so that a view of two alike things is no proof."""

TYPICAL = 2.1
"""How far an answer stands out where there is nothing to compare with, and so nothing against it:
the median of those whose mask is right."""

USUAL = 6
"""Measurements that a text asks for if nobody counts them, as of a taught word: the median's."""

OFTEN = -3.0
"""Log-probability of a noun's classes, in the object that has most of it, that says nothing."""

ABSENT = 0.1
"""Probability that the point is on the thing below which it is said not to be there. Measured, with
the classifier, at places that the constants were not fitted to: 9 % of what is there is denied, and
84 % of what is denied is not there, where half of what is asked for is."""


class Signs(NamedTuple):
    """Measurements that the confidence in an answer rests on; see the module.

    ``parts`` is the logarithm of their number, so that one part adds nothing. ``named`` is 0 where
    the noun has no classes.
    """

    evidence: float
    stands_out: float
    parts: float
    named: float = 0.0


@dataclass(frozen=True)
class Curve:
    """Of a logistic curve: what one more of each of :class:`Signs`, and nothing at all, adds."""

    evidence: float
    stands_out: float
    parts: float
    named: float
    offset: float

    def __call__(self, signs: Signs) -> float:
        """Probability in (0, 1)."""
        at = self.evidence * signs.evidence + self.stands_out * signs.stands_out
        at += self.parts * signs.parts + self.named * signs.named + self.offset
        return 1 / (1 + math.exp(-min(max(at, -50.0), 50.0)))


@dataclass(frozen=True)
class Calibration:
    """Constants of an encoder, fitted to how often its answers are right.

    Attributes
    ----------
    mask : Curve
        Of the mask: its IoU with the thing is above 0.5.
    point : Curve
        Of the point: it lies on the thing.
    """

    mask: Curve
    point: Curve


@dataclass(frozen=True)
class Confidence:
    """Probabilities in (0, 1) that an answer is right; see :class:`Calibration`."""

    mask: float
    point: float

    @property
    def verdict(self) -> str:
        """``found``, ``not sure`` (the mask is rather wrong than right) or ``not here``."""
        if self.point < ABSENT:
            return "not here"
        return "found" if self.mask >= 0.5 else "not sure"


def signs(
    gaps: np.ndarray, selected: np.ndarray, measurements: int, parts: int, named: float = 0.0
) -> Signs:
    """Measure what the confidence in an answer rests on.

    Parameters
    ----------
    gaps : float64 [M]
        Of the objects that a view shows and some photograph holds, to the text; M at least 1.
    taken : bool [M]
        The answer. Without any, the best one stands for it.
    measurements : int
        How many the text asks for.
    parts : int
        Groups of touching objects that those taken are; less than 1 counts as 1.
    named : float
        As :class:`Signs` has it.

    Returns
    -------
    Signs
        ``stands_out`` is the mean gap of those taken over the mean of the rest, in standard
        deviations of the rest; :data:`TYPICAL` where fewer than two are left to compare with.
    """
    best = float(gaps.max())
    if not selected.any():
        selected = gaps == best
    rest, stands_out = gaps[~selected], TYPICAL
    if len(rest) >= 2:
        stands_out = float((gaps[selected].mean() - rest.mean()) / (rest.std() + EVEN_OUT))
    return Signs(best * measurements, stands_out, math.log(max(parts, 1)), named)


def confidence(calibration: Calibration, at: Signs) -> Confidence:
    """Compute how likely an answer with these :func:`signs` is right."""
    return Confidence(calibration.mask(at), calibration.point(at))
