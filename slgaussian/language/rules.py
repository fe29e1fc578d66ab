"""Rules that turn relevancies into answers, and whether answers by them are calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.errors import InputError, did_you_mean
from slgaussian.language import Encoder
from slgaussian.language.relevancy import ABSENT, check_temperature
from slgaussian.language.wholes import NEAR_BEST

PHRASES = {"lerf": ("object", "things", "stuff", "texture")}
"""Named canonical phrases; LERF's are also those of LangSplat and the paper."""


@dataclass(frozen=True)
class Rules:
    """Rules that turn relevancies into answers.

    Attributes
    ----------
    threshold : float in [0, 1), optional
        Select every object with a relevancy above it, as the paper does. Its meaning depends on the
        temperature, except for 0.5 and for 0, which selects all objects.
    share : float in (0, 1]
        Used without a threshold, and independent of the temperature. Near-best objects are those
        with a relevancy above 0.5 and at least this share of the best object's gap. The answer is
        the highest-ranked of: all near-best objects, one object, or a whole of several
        (:mod:`slgaussian.language.wholes`). Without wholes or a fitted ranking (other encoders, own
        canonical phrases, names and examples) it is always the near-best objects, possibly none.
    temperature : float
        Temperature of the relevancy; does not change the order of objects.
    canonical : str or sequence of str, optional
        The phrases that a text competes with: a name in :data:`PHRASES`, phrases separated by
        commas, or a list. By default those of the encoder.
    absent : str
        ``skip`` or ``zero``, the paper's zero vector; see
        :data:`slgaussian.language.relevancy.ABSENT`.

    Raises
    ------
    InputError
        If a value is out of range.
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
        """Name of the selection rule: ``near-best`` or ``threshold``."""
        return "near-best" if self.threshold is None else "threshold"

    @property
    def least_gap(self) -> float:
        """Gap that corresponds to ``threshold``; 0 (relevancy 0.5) by default."""
        if not self.threshold:
            return 0.0 if self.threshold is None else -np.inf
        return float(np.log(self.threshold) - np.log1p(-self.threshold)) / self.temperature


def unmeasured(encoder: Encoder, rules: Rules) -> str:
    """Name the setting without a calibration; empty if answers are calibrated."""
    if encoder.calibration is None:
        return f"the encoder {encoder.name}"
    return "" if rules.canonical is None else "canonical phrases of your own"
