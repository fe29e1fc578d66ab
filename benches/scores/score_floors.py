"""Scores of the default method over seeds, from which ``tests/test_floors.py`` has its limits.

``python -m benches.scores.score_floors [SEEDS] [DATA]`` measures the mean IoU of texts and the PSNR
of novel views (dB) in procedural rooms; bad-2.0 and the mean relative error of depth of the
motorcycle pair; and, with DATA, a folder with ``office`` and ``places``, the mean IoU there. The
scenes are fixed; the seed determines the random draws of the method. Each line has the mean,
standard deviation, minimum and maximum of a score.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, read_truth
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate, truth_from_instances
from slgaussian.benchmark.index import read_index
from slgaussian.benchmark.metrics import depth_errors
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.gaussians import source_depths
from slgaussian.labels import LabelMaps
from slgaussian.predict import load_predictor
from slgaussian.scene import Sample

ROOMS, ROOM_SIZE = (0, 1, 2, 3), (156, 216)

SIZE = "at most 208x288"
"""Size of real photographs: a quarter of the default number of pixels, to save time."""

OFFICE = ("hall_sofa", "red_crate", "coffee_machine", "sofa_plant")
PLACES = {"kitchen": "kitchen", "castle": "castle", "dining": "dining_mug"}
"""Scenes of the office, and scenes of the places by folder."""


def rooms(seed: int) -> dict[str, float]:
    """Return mean ``iou`` and ``psnr`` of two views between the context views of :data:`ROOMS`."""
    metrics = []
    for number in ROOMS:
        height, width = ROOM_SIZE
        room = datasets.load("procedural", seed=number, height=height, width=width)
        sample = room.sample(["view_00", "view_03"], ["view_01", "view_02"])
        metrics.append(_scores(sample, truth_from_instances(sample), seed))
    return {name: float(np.mean([scores[name] for scores in metrics])) for name in ("iou", "psnr")}


def motorcycle(seed: int) -> dict[str, float]:
    """Return ``bad2`` and ``abs_rel`` of the left view's depth, at full size."""
    sample = datasets.load("stereo").sample(["left", "right"], size="original")
    left, right = (view.camera for view in sample.context)
    gaussians = load_predictor("planesweep")(sample, seed)
    depth = source_depths(gaussians, [left, right])[0]
    scale = left.K[0, 0] * float(np.linalg.norm(right.center - left.center))
    depth_scores = depth_errors(depth, sample.context[0].depth, scale)
    return {name: depth_scores[name] for name in ("bad2", "abs_rel")}


def office(data: Path, seed: int) -> dict[str, float]:
    """Return the mean ``iou`` in the target views of :data:`OFFICE`."""
    return _score_labelled(dict.fromkeys(OFFICE, data / "office"), seed)


def places(data: Path, seed: int) -> dict[str, float]:
    """Return the mean ``iou`` in the target views of :data:`PLACES`."""
    return _score_labelled(
        {name: data / "places" / folder for folder, name in PLACES.items()}, seed
    )


def _score_labelled(folders: Mapping[str, Path], seed: int) -> dict[str, float]:
    ious = []
    for name, folder in folders.items():
        pair = read_index(folder / "pairs.json").scenes[name]
        scene = datasets.load("nerfstudio", path=folder)
        sample = scene.sample(pair.context, pair.target, size=SIZE)
        truth = read_truth(folder / "labels", pair.categories, sample.targets)
        ious.append(_scores(sample, truth, seed)["iou"])
    return {"iou": float(np.mean(ious))}


def _scores(sample: Sample, truth: Truth, seed: int) -> dict:
    field = build_field(sample, Method(seed=seed))
    unused = np.zeros((1, 1, 1), np.int32)  # label maps are only used for pictures
    maps = LabelMaps(unused, unused)
    settings = EvaluationSettings(protocols=["slgaussian"], drawn=False)
    return evaluate(field, sample, maps, truth, settings).scene_metrics


def main(seeds: int = 8, data: str | None = None) -> None:
    """Print a line per score; and to stderr, a line per seed and part, with CPU seconds."""
    parts = {"rooms": rooms, "motorcycle": motorcycle}
    if data is not None:
        parts |= {"office": partial(office, Path(data)), "places": partial(places, Path(data))}
    values_of: dict[str, list[float]] = {}
    for seed in range(seeds):
        for part, measure in parts.items():
            start = time.process_time()
            scores = measure(seed)
            seconds = time.process_time() - start
            print(part, seed, scores, f"{seconds:.1f} s", file=sys.stderr, flush=True)
            for name, value in scores.items():
                values_of.setdefault(f"{part} {name}", []).append(value)
    for name, values in values_of.items():
        spread = np.std(values, ddof=1)
        ends = f"{min(values):.4f} to {max(values):.4f}"
        print(f"{name:20} {np.mean(values):.4f} +- {spread:.4f}, {ends}, {len(values)} seeds")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]), *sys.argv[2:3])
