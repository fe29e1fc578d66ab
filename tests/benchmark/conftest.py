"""One small room with exact truth and a field of it, made by the real parts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.evaluate import (
    EvaluationSettings,
    SceneResult,
    evaluate,
    truth_from_instances,
)
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.predict import load_predictor
from slgaussian.scene import Sample
from tests.known import known_field


@dataclass(frozen=True, eq=False)
class Room:
    sample: Sample
    label_maps: LabelMaps
    field: SemanticField
    gaussians: Gaussians
    truth: dict[str, dict[str, np.ndarray]]

    @property
    def strange_truth(self) -> dict[str, dict[str, np.ndarray]]:
        """Return the truth with an unknown word and a query of an absent object."""
        masks = self.truth["view_01"]
        some = next(iter(masks.values()))
        return {"view_01": masks | {"qqwx": some, "red sofa": np.zeros_like(some)}}

    def evaluate(
        self, truth: Mapping | None = None, boxes: Mapping | None = None, **settings: Any
    ) -> SceneResult:
        """Evaluate the field with its own ground truth, or another one."""
        frame_truth = Truth(self.truth if truth is None else truth, boxes or {})
        evaluation = EvaluationSettings(**settings)
        return evaluate(
            self.field,
            self.sample,
            self.label_maps,
            frame_truth,
            evaluation,
            gaussians=self.gaussians,
        )


@pytest.fixture(scope="session")
def room() -> Room:
    """Build the room with true instances as labels, as errors of masks would blur the scores."""
    scene = datasets.load("procedural", seed=3, objects=4, views=3, height=104, width=144)
    sample = scene.sample(["view_00", "view_02"], ["view_01"])
    labels = np.stack([view.instances for view in sample.context])
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    gaussians = load_predictor("planesweep")(sample)
    field = known_field(sample, gaussians, label_maps, Method(codes="grid"))
    return Room(sample, label_maps, field, gaussians, truth_from_instances(sample).masks)


@pytest.fixture(scope="session")
def result(room) -> SceneResult:
    return room.evaluate(room.strange_truth, queries=("grey floor",))


@pytest.fixture(scope="session")
def own_result(room) -> SceneResult:
    """Scores of the field's answers to all labelled queries of the room."""
    return room.evaluate()
