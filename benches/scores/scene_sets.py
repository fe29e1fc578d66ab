"""Sets of scenes over which the pages report means, and their fields with several seeds.

DATA holds the labelled folders ``office`` and ``places``; rooms are procedural.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flows.config import SceneSettings, Settings
from flows.scenes import ROOMS, demo_scenes, labelled_scenes, room_scene
from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, read_truth
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.build import build_memory_bank, label_views, lift_field, predict
from slgaussian.kernels.seeding import rng_for
from slgaussian.scene import Sample
from slgaussian.semantic.hard import code_images

PLACES = ("dining", "castle", "kitchen", "bonsai", "street", "lounge")
UNSEEN = range(40, 60)
"""Rooms on which no constant was chosen."""

SHEETS = ("office/pairs.json", *(f"places/{name}/pairs.json" for name in PLACES))
"""Required files in DATA."""


THINGS = ("boxes", "can", "carton", "duck", "stitch")


@dataclass(frozen=True)
class Set:
    """Scenes that are averaged; ``chosen``: whether constants were chosen on them."""

    chosen: bool
    scenes: Callable[[Path], list[SceneSettings]]


def find_labelled(names: Sequence[str], data: Path) -> list[SceneSettings]:
    """Return the scenes of labelled folders below DATA."""
    scenes = []
    for name in names:
        folder = data / name
        settings = Settings(data=folder, pairs=folder / "pairs.json", labels=folder / "labels")
        scenes += labelled_scenes(settings)[0]
    return scenes


SETS: Mapping[str, Set] = {
    "office": Set(True, partial(find_labelled, ["office"])),
    "demo": Set(True, lambda _: [room_scene(seed) for seed in ROOMS]),
    "motorcycle": Set(
        True, lambda _: [scene for scene in demo_scenes() if scene.dataset == "stereo"]
    ),
    "places": Set(True, partial(find_labelled, [f"places/{name}" for name in PLACES])),
    "things": Set(True, partial(find_labelled, [f"things/{name}" for name in THINGS])),
    "rooms": Set(False, lambda _: [room_scene(seed) for seed in UNSEEN]),
}


def read(scene: SceneSettings, settings: Settings) -> Sample:
    paths = [] if scene.path is None else [scene.path]
    loaded = datasets.load(scene.format, *paths, **scene.options)
    return loaded.sample(scene.context, scene.targets, scene.size or settings.size)


def read_truth_of_scene(scene: SceneSettings, sample: Sample) -> Truth:
    """Return the labels of the targets of a scene, or the ground truth of a procedural room."""
    if scene.labels is None:
        return truth_from_instances(sample)
    return read_truth(scene.labels, scene.categories, sample.targets)


def build_fields(sample: Sample, seeds: Sequence[int]) -> Iterator[Inputs]:
    """Yield the field of each seed, with its inputs.

    In the default method the seed determines only the ID codes, and each Gaussian has the code of
    one object. So the field is built once, with the first seed, and the codes are replaced for the
    others; the bytes equal those of separate builds.
    """
    method = Settings().field_method.model_copy(update={"seed": seeds[0]})
    predictor, proposer, tracker, encoder, draw, lifting = (c.load() for c in method.components)
    predicted = predict(sample, predictor, method.seed, trust_cameras=True)
    gaussians, geometry, quality, depths = predicted
    labels = label_views(geometry, proposer, tracker, method.replicas)
    bank = build_memory_bank(sample, geometry, labels, encoder, draw, method.seed)
    field = lift_field(sample, gaussians, labels, bank, lifting, method, quality, depths)
    object_ids = field.labels()
    for seed in seeds:
        codes = draw(labels, rng_for(seed, sample.content, "codes"))
        features = torch.from_numpy(code_images(object_ids, bank.ids, codes))
        coded = field.with_changes(
            gaussians=replace(field.gaussians, features=features),
            bank=replace(bank, codes=codes),
        )
        yield Inputs(sample, coded, gaussians, labels, proposer, seed)


def over_seeds(rows: Sequence[Mapping[str, Any]], name: str, key: str) -> list[float]:
    """Return the mean of a metric over the scenes of a set, for each seed."""
    selected = [row for row in rows if row["set"] == name and key in row]
    seeds = sorted({row["seed"] for row in selected})
    return [float(np.mean([row[key] for row in selected if row["seed"] == seed])) for seed in seeds]
