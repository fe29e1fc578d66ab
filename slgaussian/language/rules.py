"""Rules by which a text becomes an answer, and whether those were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.errors import InputError, did_you_mean
from slgaussian.language import Encoder
from slgaussian.language.relevancy import ABSENT, check_temperature
from slgaussian.language.wholes import NEAR_BEST

PHRASES = {"lerf": ("object", "things", "stuff", "texture")}
"""Canonical phrases by name: LERF's, which LangSplat and the paper use too."""


@dataclass(frozen=True)
class Rules:
    """Rules by which a text becomes an answer.

    Attributes
    ----------
    threshold : float in [0, 1), optional
        Absolute: select every object whose relevancy is above it, as the paper does. It means
        something else at every temperature, unless it is 0.5, or 0, which selects all.
    share : float in (0, 1]
        Without a threshold, relative and the same at all temperatures: objects above 0.5 whose gap
        to the canonical phrases is at least this share of the best object's gap fit about as well.
        These together, one object or a whole of several are selected, whichever ranks first
        (:mod:`slgaussian.language.wholes`); always these, and none if no object fits better
        than "object" does, where a bank knows no wholes or that was not measured: of an encoder
        without a ranking, with canonical phrases of one's own, by names and examples.
    temperature : float
        Of the relevancy; changes its scale, never the order of objects.
    canonical : str or sequence of str, optional
        The phrases that a text competes with; one string is a name in :data:`PHRASES`, or phrases
        with commas between them. Those of the encoder if left out.
    absent : str
        ``skip`` or ``zero``, the paper's zero vector; see
        :data:`slgaussian.language.relevancy.ABSENT`.

    Raises
    ------
    InputError
        If one of them is out of range.
    """

    threshold: float | None = None
    share: float = NEAR_BEST
    temperature: float = 10.0
    canonical: str | Sequence[str] | None = None
    absent: str = "skip"

    def __post_init__(self) -> None:
        check_temperature(self.temperature)
        if self.absent not in ABSENT:
            raise InputError(
                f"absent: found {self.absent!r}, expected one of {', '.join(ABSENT)}"
                f"{did_you_mean(self.absent, ABSENT)}"
            )
        if self.threshold is not None and not 0 <= self.threshold < 1:
            raise InputError(
                f"threshold: found {self.threshold}, expected a number from 0 to below 1"
            )
        if not 0 < self.share <= 1:
            raise InputError(f"share: found {self.share}, expected a number above 0, at most 1")
        if self.phrases is not None and not all(self.phrases):
            raise InputError(
                f"canonical: found {self.canonical!r}, expected a name ({', '.join(PHRASES)}) or "
                "phrases with commas between them, none empty"
            )

    @property
    def phrases(self) -> tuple[str, ...] | None:
        """The canonical phrases; None stands for the encoder's own."""
        if self.canonical is None:
            return None
        if not isinstance(self.canonical, str):
            return tuple(self.canonical) or ("",)
        split = tuple(phrase.strip() for phrase in self.canonical.split(","))
        return PHRASES.get(self.canonical, split)

    @property
    def selection(self) -> str:
        """Way of selecting objects: ``near-best`` or ``threshold``."""
        return "near-best" if self.threshold is None else "threshold"

    @property
    def least_gap(self) -> float:
        """Gap above which a text fits an object; 0, that of the canonical phrases, by default."""
        if not self.threshold:
            return 0.0 if self.threshold is None else -np.inf
        return float(np.log(self.threshold) - np.log1p(-self.threshold)) / self.temperature


def unmeasured(encoder: Encoder, rules: Rules) -> str:
    """Name that for which it was not measured how often answers are right; empty if it was."""
    if encoder.calibration is None:
        return f"the encoder {encoder.name}"
    return "" if rules.canonical is None else "canonical phrases of your own"
