"""From context photographs to Gaussians: the predictors and how to get one by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from slgaussian.components.registry import load_component

if TYPE_CHECKING:  # the names of predictors are asked for where nobody waits for torch
    from slgaussian.cameras.match_graph import MatchGraph
    from slgaussian.gaussians import Gaussians
    from slgaussian.scene import Sample

PREDICTORS = {
    "planesweep": "slgaussian.predict.configs:PlaneSweepConfig",
    "mvsplat": "slgaussian.predict.configs:MVSplatConfig",
    "precomputed": "slgaussian.predict.configs:PrecomputedGeometryConfig",
}


class GaussianPredictor(Protocol):
    """Anything that turns the context views of a sample into Gaussians."""

    def __call__(self, sample: Sample, seed: int = 0, graph: MatchGraph | None = None) -> Gaussians:
        """Predict Gaussians in the world frame of the sample; targets must not be read.

        Whatever is drawn at random depends on ``seed`` and on what the context views show.
        ``graph`` holds their matches; whoever needs them finds them if it is left out.
        """


class Depths(NamedTuple):
    """How many depth candidates were compared in all views, and how many the settings allow."""

    tried: int
    possible: int


@runtime_checkable
class CountingPredictor(GaussianPredictor, Protocol):
    """One that compares depths and counts them; no predictor has to."""

    def counted(
        self, sample: Sample, seed: int = 0, graph: MatchGraph | None = None
    ) -> tuple[Gaussians, Depths]:
        """What a call gives, and the depths that it took."""


def load_predictor(name: str = "planesweep", **settings: Any) -> GaussianPredictor:
    """Make the predictor called ``name``; ``settings`` are its own (see its class).

    Raises
    ------
    InputError
        If the name is unknown.
    """
    return load_component("predictor", name, settings)
