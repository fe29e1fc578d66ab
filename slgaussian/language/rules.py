"""Rules that turn relevancies into answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from pydantic import Field, field_validator

from slgaussian.components.config import Config

CANONICAL_PHRASES = {"lerf": ("object", "things", "stuff", "texture")}
"""Named canonical phrases; LERF's are also those of LangSplat and the paper."""


def _split(canonical: str | Sequence[str]) -> tuple[str, ...]:
    if not isinstance(canonical, str):
        return tuple(canonical) or ("",)
    split = tuple(phrase.strip() for phrase in canonical.split(","))
    return CANONICAL_PHRASES.get(canonical, split)


NEAR_BEST = 0.6
"""An object is near-best if its gap is at least this fraction of the best gap."""

ABSENT_TREATMENTS = ("skip", "zero")
"""Treatment of views that do not show an object. ``skip``: ignored. ``zero``: the paper's zero
vector, which gives gap 0 and relevancy 0.5 for every text."""


class Rules(Config):
    """Rules that turn relevancies into answers.

    Without a threshold, the answer does not depend on the temperature: near-best objects are those
    with a relevancy above 0.5 and at least ``share`` of the best object's gap, and the answer is
    the highest-ranked of all near-best objects, one object, or a whole of several
    (:mod:`slgaussian.language.wholes`). Without wholes or a fitted ranking (other encoders, own
    canonical phrases, names and examples) it is always the near-best objects, possibly none.
    """

    threshold: float | None = Field(
        None,
        ge=0,
        lt=1,
        description="Accept objects whose relevancy is above this, 0 to 1.",
    )
    share: float = Field(
        NEAR_BEST,
        gt=0,
        le=1,
        description="Without a threshold: accept objects with this fraction of the best object's "
        "lead over the canonical phrases.",
    )
    temperature: float = Field(10.0, gt=0, description="Temperature of the relevancy.")
    canonical: str | Sequence[str] | None = Field(
        None,
        description="Phrases that a text competes with, separated by commas, or lerf for LERF's "
        "four; default: those of the encoder.",
    )
    absent: Literal["skip", "zero"] = Field(
        "skip",
        examples=list(ABSENT_TREATMENTS),
        description="Score of a view that does not show an object: skip (none), or zero (as the "
        "paper).",
    )

    @field_validator("canonical")
    @classmethod
    def _check_phrases(cls, canonical: str | Sequence[str] | None) -> str | Sequence[str] | None:
        if canonical is not None and not all(_split(canonical)):
            raise ValueError(
                f"expected a name ({', '.join(CANONICAL_PHRASES)}) or phrases with commas between "
                "them, none empty"
            )
        return canonical

    @property
    def phrases(self) -> tuple[str, ...] | None:
        """The canonical phrases; None stands for the encoder's own."""
        return None if self.canonical is None else _split(self.canonical)

    @property
    def selection(self) -> str:
        """Name of the selection rule: ``near-best`` or ``threshold``."""
        return "near-best" if self.threshold is None else "threshold"

    @property
    def least_gap(self) -> float:
        """Gap that corresponds to ``threshold``; 0 (relevancy 0.5) by default."""
        if not self.threshold:
            return 0.0 if self.threshold is None else -math.inf
        return (math.log(self.threshold) - math.log1p(-self.threshold)) / self.temperature
