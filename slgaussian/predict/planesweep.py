"""Gaussians from posed photographs without any learned weights: a plane sweep (Collins 1996)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slgaussian.errors import InputError
from slgaussian.parts.settings import check_settings, setting

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.predict import Depths
    from slgaussian.scene import Sample


@dataclass(frozen=True)
class PlaneSweep:
    """Depth by plane sweep and semi-global matching, one Gaussian a context pixel and some more.

    Each view is matched against the few that tell most of its depth; what they confirm is kept, the
    rest is lent by them or filled with planes of the scene. What others draw twice already is not
    drawn again. See ``sweep`` in this package, and what it imports.

    Attributes
    ----------
    near, far : float or None
        Depth range along z in scene units. None takes the context camera's own, and where that
        has none either, estimates it from sparse matches between the views.
    depth_candidates : int
        Most depths that are compared, 8 to 512. A pair gets one for each pixel of motion over the
        image, and no more than that; time and memory go with their number. More than the default
        gain nothing that these are worth.
    """

    near: float | None = None
    far: float | None = None
    depth_candidates: int = setting(
        144,
        "Most depths that planesweep compares, 8 to 512; a pair gets no more than it needs.",
        low=8,
        high=512,
        expected="a whole number from 8 to 512",
    )

    def __post_init__(self) -> None:
        for name, value in (("near", self.near), ("far", self.far)):
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"plane sweep {name}: found {value}, expected a positive number")
        if self.near is not None and self.far is not None and self.near >= self.far:
            raise InputError(
                f"plane sweep: near {self.near:g} must be below far {self.far:g}; correct them"
            )
        check_settings(self, "plane sweep")

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Gaussians in the world frame of ``sample``.

        First one a context pixel, in the order of ``source``, but for those that show what two
        views before show already; then a few for what no view sees.
        Nothing of it is random, so ``seed`` changes nothing.

        Raises
        ------
        InputError
            If no depth range is given and too few matches are found to estimate it, if near is not
            below far, if two views see nothing in common within the range, or if matches say that
            they were taken from one place or that their poses are exchanged.
        """
        return self.counted(sample, seed)[0]

    def counted(self, sample: Sample, seed: int = 0) -> tuple[Gaussians, Depths]:
        """What a call gives, and how many depths were compared; raises as a call."""
        from slgaussian.predict.sweep import predict

        return predict(self, sample)
