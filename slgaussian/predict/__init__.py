"""Predictors of Gaussians from context photographs, and their loader by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from slgaussian.components.registry import load_component

if TYPE_CHECKING:  # names of predictors are read where torch is not imported
    from slgaussian.gaussians import Gaussians
    from slgaussian.scene import Sample


class GaussianPredictor(Protocol):
    """A callable from the context views of a sample to Gaussians."""

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Predict Gaussians in the world frame of the sample; targets must not be read.

        Random numbers depend on ``seed`` and the content of the context views. A predictor that
        needs matches takes those of :func:`slgaussian.cameras.match_graph.match_views`.
        """


class Depths(NamedTuple):
    """Number of depth candidates that were compared in all views, and the number allowed."""

    tried: int
    possible: int


@runtime_checkable
class CountingPredictor(GaussianPredictor, Protocol):
    """A predictor that counts the depth candidates that it compares."""

    def predict_with_counts(self, sample: Sample, seed: int = 0) -> tuple[Gaussians, Depths]:
        """Predict as by a call, and count the depth candidates."""


@runtime_checkable
class SplatReader(GaussianPredictor, Protocol):
    """A predictor whose Gaussians exist already: in the world, of no pixel, kept as they are."""

    def read(self, scene: str) -> Gaussians:
        """Read the Gaussians of a scene, ``source`` -1."""


def load_predictor(name: str = "planesweep", **settings: Any) -> GaussianPredictor:
    """Load the predictor ``name``; ``settings`` are the fields of its class.

    Raises:
        InputError: If the name is unknown.
    """
    return load_component("predictor", name, settings)
