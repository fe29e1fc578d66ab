"""Probability that an answer is right, by logistic regression on four features of the answer.

The score of the best object says how well the text fits it, but some object fits best in every
view. The features are:

- the *evidence* for the best object: its gap times the number of measurements that the text asks
  for, as a naive Bayes classifier sums log-odds. A gap is a mean, and a high mean of few
  measurements is more likely to be chance;
- how many standard deviations the answer's objects *stand out* from the other objects, less if
  the others are fewer: what is not in a scene is often answered with nearly all of it;
- the number of disconnected *parts* of the answer: objects that fit best by chance are scattered;
- if the noun is a class of the classifier, the highest log-probability of that class in any object
  of the scene (*named*). It is the best indicator of absent objects.

The coefficients belong to the encoder, since the scale of its cosines does.
``benches/language/answer_confidence.py`` fits them and evaluates them at held-out places.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

STD_OFFSET = 0.02
"""Added to the standard deviation of the other objects, as two similar objects have almost none."""

TYPICAL_STAND_OUT = 2.1
"""Value of ``stands_out`` without other objects to compare with: the median of right masks."""

NEUTRAL_LOG_PROBABILITY = -3.0
"""Highest log-probability of a noun's classes in any object at which it is neutral evidence."""

MIN_POINT_PROBABILITY = 0.1
"""Probability of the point being on the object below which the object is reported as absent. At
labelled places, with the classifier, where half of the queried objects are present: 14 % of present
objects are reported as absent, and 80 % of the objects reported as absent are."""


class Signs(NamedTuple):
    """Features of the logistic regression; see the module.

    ``parts`` is the logarithm of the number of parts, 0 for one part. ``named`` is 0 if the noun
    has no classes.
    """

    evidence: float
    stands_out: float
    parts: float
    named: float = 0.0


class Curve(NamedTuple):
    """Coefficients of the logistic regression on :class:`Signs`, and its intercept (``offset``)."""

    evidence: float
    stands_out: float
    parts: float
    named: float
    offset: float

    def __call__(self, signs: Signs) -> float:
        """Compute the probability, in (0, 1)."""
        at = sum(weight * sign for weight, sign in zip(self, signs, strict=False)) + self.offset
        return 1 / (1 + math.exp(-min(max(at, -50.0), 50.0)))


class Calibration(NamedTuple):
    """Fitted coefficients of an encoder.

    Attributes:
        mask: Probability that the IoU of the mask with the object is above 0.5.
        point: Probability that the point lies on the object.
    """

    mask: Curve
    point: Curve

    def __call__(self, signs: Signs) -> Confidence:
        """Compute the probabilities that an answer with these :func:`signs` is right."""
        return Confidence(self.mask(signs), self.point(signs))


class Confidence(NamedTuple):
    """Probabilities in (0, 1) that an answer is right; see :class:`Calibration`."""

    mask: float
    point: float

    @property
    def verdict(self) -> str:
        """``found``, ``not sure`` (the mask is probably wrong) or ``not here``."""
        if self.point < MIN_POINT_PROBABILITY:
            return "not here"
        return "found" if self.mask >= 0.5 else "not sure"


def signs(
    gaps: np.ndarray, selected: np.ndarray, measurements: int, parts: int, named: float = 0.0
) -> Signs:
    """Compute the features of an answer.

    ``stands_out`` is the mean gap of the selected objects minus that of the others, in standard
    deviations of the others; :data:`TYPICAL_STAND_OUT` with fewer than two others. For S selected
    objects and R < S - 1 others it is multiplied by (R + 1) / S.

    Args:
        gaps: float64 [M]. Gaps of the M > 0 visible objects that some photograph shows.
        selected: bool [M]. Objects of the answer; if none is, the best one is used.
        measurements: Number of measurements that the text asks for.
        parts: Number of connected parts of the selected objects; 0 counts as 1.
        named: See :class:`Signs`.
    """
    best = float(gaps.max())
    if not selected.any():
        selected = gaps == best
    rest, stands_out = gaps[~selected], TYPICAL_STAND_OUT
    if len(rest) >= 2:
        stands_out = float((gaps[selected].mean() - rest.mean()) / (rest.std() + STD_OFFSET))
    stands_out *= min(1.0, (len(rest) + 1) / int(selected.sum()))
    return Signs(best * measurements, stands_out, math.log(max(parts, 1)), named)
