"""Configs of the choice of views."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field, model_validator

from slgaussian.components.config import Config

NAME, VERSION = "around", 1
"""Name and version of :class:`Rule` in index files; the choice is constant within a version."""


class PairBounds(Config):
    """Requirements on two context views.

    The overlap is the fraction of a context view that projects into the other, the smaller of the
    two, assuming that all of it lies at the view's typical depth; the baseline is the distance of
    the cameras over that depth. With a wide baseline, overlapping surfaces may be occluded or
    visible from another side only. See :mod:`slgaussian.datasets.sharpness` for blur.
    """

    min_overlap: float = Field(
        0.6, ge=0, le=1, description="Smallest overlap of context views, as a fraction."
    )
    max_overlap: float = Field(
        1.0, ge=0, le=1, description="Largest overlap of context views, as a fraction."
    )
    min_baseline: float = Field(
        0.08,
        ge=0,
        description="Smallest distance of context cameras, as a fraction of the scene's depth.",
    )
    max_baseline: float = Field(
        0.4, ge=0, description="Largest distance of context cameras, likewise."
    )
    max_blur: float = Field(
        0.16,
        ge=0,
        description="Largest blur of a view above the median of its clip, 0 to 1.",
    )
    max_clipped: float = Field(
        0.4, ge=0, le=1, description="Largest black or white fraction of a view."
    )

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        for name in ("overlap", "baseline"):
            low, high = getattr(self, f"min_{name}"), getattr(self, f"max_{name}")
            if low > high:
                raise ValueError(
                    f"min_{name} {low:g} is above max_{name} {high:g}; no pair can fit"
                )
        return self


class Bounds(PairBounds):
    """Requirements on the samples of a clip."""

    most: int = Field(0, ge=0, description="Largest number of samples of a clip; 0 for all.")


class Rule(PairBounds):
    """Requirements on two context views and the target between them."""

    min_cover: float = Field(
        0.9, ge=0, le=1, description="Smallest fraction of a labelled frame in the context views."
    )
    max_aside: float = Field(
        0.3,
        ge=0,
        lt=0.5,
        description="Largest distance of a labelled frame from the midpoint of the context "
        "cameras, as a fraction of their distance.",
    )

    def describe(self) -> dict[str, Any]:
        """Return name, version and settings of the rule, for an index file."""
        return {"name": NAME, "version": VERSION, **dict(self)}
