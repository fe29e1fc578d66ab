"""How likely an answer is right, from how its objects stand out of the rest of the view.

A score says how well a text fits the best object, not whether that is the thing: in every view
something fits best. Two numbers tell right answers from others nearly as well as a dozen do: the
gap of the best object to the canonical phrases, and how many standard deviations the objects of the
answer stand above those of the rest. A logistic curve makes probabilities of them, whose constants
an encoder brings along, as its cosines have a scale of their own.

``benches/language/answer_confidence.py`` fits the constants, and says how they do at places that
they were not fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

EVEN_OUT = 0.02
"""Added to the standard deviation of the rest, so that a view of two alike things is no proof."""

TYPICAL = 1.1
"""How far an answer stands out where there is nothing to compare with: the median answer's."""

ABSENT = 0.18
"""Probability that the point is on the thing below which it is said not to be there. Measured: 85 %
of the points that are right lie above it, at places that the constants were not fitted to."""


@dataclass(frozen=True)
class Curve:
    """Of a logistic curve: what a gap of 1, a standard deviation and nothing at all add to it."""

    gap: float
    stands_out: float
    offset: float

    def __call__(self, gap: float, stands_out: float) -> float:
        """Probability in (0, 1)."""
        at = self.gap * gap + self.stands_out * stands_out + self.offset
        return 1 / (1 + math.exp(-min(max(at, -50.0), 50.0)))


@dataclass(frozen=True)
class Calibration:
    """What an encoder knows of how often its answers are right.

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
    """How likely an answer is right; see :class:`Calibration`. Probabilities in (0, 1)."""

    mask: float
    point: float

    @property
    def verdict(self) -> str:
        """``found``, ``not sure`` (the mask is rather wrong than right) or ``not here``."""
        if self.point < ABSENT:
            return "not here"
        return "found" if self.mask >= 0.5 else "not sure"


def signs(gaps: np.ndarray, taken: np.ndarray) -> tuple[float, float]:
    """What the confidence in an answer rests on: the best gap, and how far the answer stands out.

    Parameters
    ----------
    gaps : float64 [M]
        Of the objects that a view shows and some photograph holds, to the text; M at least 1.
    taken : bool [M]
        The answer. Without any, the best one stands for it.

    Returns
    -------
    gap, stands_out : float
        ``stands_out`` is the mean gap of those taken over the mean of the rest, in standard
        deviations of the rest; :data:`TYPICAL` where fewer than two are left to compare with.
    """
    best = float(gaps.max())
    if not taken.any():
        taken = gaps == best
    rest = gaps[~taken]
    if len(rest) < 2:
        return best, TYPICAL
    return best, float((gaps[taken].mean() - rest.mean()) / (rest.std() + EVEN_OUT))


def confidence(calibration: Calibration, gaps: np.ndarray, taken: np.ndarray) -> Confidence:
    """How likely an answer is right; ``gaps`` and ``taken`` as in :func:`signs`."""
    at = signs(gaps, taken)
    return Confidence(calibration.mask(*at), calibration.point(*at))
