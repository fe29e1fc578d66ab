"""What ``--seed`` changes.

    python -m benches.scores.seed_spread DATA [-o docs/measured] [--rows FILE]

DATA holds ``office`` and ``places``. Every set of scenes is done with several seeds, as
``slgaussian benchmark --seed`` does it. The page says the mean over scenes, and of that the mean,
deviation and extremes over seeds. Rows are kept in FILE as they come, and what it holds is not done
again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from flows.demo import ROOMS, demo_scenes
from flows.labelled import labelled_scenes
from flows.room_scenes import room_scene
from flows.settings import SceneSettings, Settings
from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, read_truth
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate, truth_from_instances
from slgaussian.benchmark.summary import METRICS
from slgaussian.build import label_views, lift_field, predict, remember
from slgaussian.errors import InputError
from slgaussian.geometry import SceneGeometry
from slgaussian.kernels import threads
from slgaussian.scene import Sample

PLACES = ("dining", "castle", "kitchen", "bonsai", "street", "lounge")
UNSEEN = range(40, 60)
"""Rooms that nothing was chosen on."""

SHOWN = ("iou", "hit_mask", "miou", "psnr", "ssim", "abs_rel", "bad2")


@dataclass(frozen=True)
class Set:
    """Scenes that are averaged; ``chosen`` says whether constants were chosen on them."""

    title: str
    command: str
    chosen: bool
    seeds: int
    scenes: Callable[[Path], list[SceneSettings]]


def labelled(names: Sequence[str], data: Path) -> list[SceneSettings]:
    found = []
    for name in names:
        folder = data / name
        asked = Settings(data=folder, pairs=folder / "pairs.json", labels=folder / "labels")
        found += labelled_scenes(asked)[0]
    return found


OF_LABELS = "slgaussian benchmark --data {0} --pairs {0}/pairs.json --labels {0}/labels --seed K"
SETS = {
    "office": Set(
        "office: 8 pairs of one building, 57 queries",
        OF_LABELS.format("DATA/office"),
        True,
        3,
        partial(labelled, ["office"]),
    ),
    "demo": Set(
        "demo: rooms 0 to 2",
        "slgaussian demo --seed K",
        True,
        3,
        lambda _: [room_scene(seed) for seed in ROOMS],
    ),
    "motorcycle": Set(
        "demo: the motorcycle",
        "slgaussian demo --seed K",
        True,
        3,
        lambda _: [scene for scene in demo_scenes() if scene.dataset == "stereo"],
    ),
    "places": Set(
        "places: 8 pairs of 6 other places, 63 queries",
        OF_LABELS.format("DATA/places/PLACE") + ", place by place",
        True,
        3,
        partial(labelled, [f"places/{name}" for name in PLACES]),
    ),
    "rooms": Set(
        f"rooms {UNSEEN[0]} to {UNSEEN[-1]}",
        f"slgaussian benchmark --rooms {UNSEEN[0]}-{UNSEEN[-1]} --seed K",
        False,
        3,
        lambda _: [room_scene(seed) for seed in UNSEEN],
    ),
}


def read(scene: SceneSettings, settings: Settings) -> Sample:
    paths = [] if scene.path is None else [scene.path]
    found = datasets.load(scene.format, *paths, **scene.options)
    return found.sample(scene.context, scene.targets, scene.size or settings.size)


def scored(scene: SceneSettings, seeds: Sequence[int]) -> list[dict[str, float]]:
    """The metrics of a scene with each seed."""
    threads.limit(threads.cores())
    sample = read(scene, Settings())
    if scene.labels is None:
        truth = truth_from_instances(sample)
    else:
        truth = read_truth(scene.labels, scene.categories, sample.targets)
    return [score(sample, scene, truth, seed) for seed in seeds]


def score(sample: Sample, scene: SceneSettings, truth: Truth, seed: int) -> dict[str, float]:
    """The metrics of a field that is built from a sample of a scene."""
    settings = Settings()
    method = replace(settings.built_by, seed=seed)
    gaussians, quality, depths = predict(sample, method.predictor, seed, trust_cameras=True)
    geometry = SceneGeometry.of(sample.context, gaussians)
    labels = label_views(geometry, method.proposer, method.tracker, method.replicas)
    bank = remember(sample, geometry, labels, method.encoder, method.codes, seed)
    field = lift_field(sample, gaussians, labels, bank, method, quality, depths)
    result = evaluate(
        field,
        sample,
        labels,
        truth,
        EvaluationSettings(queries=scene.queries, protocols=[settings.protocol], drawn=False),
        gaussians=gaussians,
    )
    return {key: float(value) for key, value in result.scene_metrics.items()}


def measure(data: Path, names: Sequence[str], file: Path, workers: int) -> list[dict[str, Any]]:
    """A row a set, scene and seed, of those named."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    there = {(row["set"], row["scene"], row["seed"]) for row in rows}
    with (
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
        file.open("a") as out,
    ):
        jobs = {}
        for name in names:
            for first in range(0, SETS[name].seeds, 2):
                for scene in SETS[name].scenes(data):
                    wanted = range(first, min(first + 2, SETS[name].seeds))
                    seeds = [seed for seed in wanted if (name, scene.name, seed) not in there]
                    if seeds:
                        jobs[pool.submit(scored, scene, seeds)] = name, scene.name, seeds
        for job in as_completed(jobs):
            name, scene, seeds = jobs[job]
            for seed, metrics in zip(seeds, job.result(), strict=True):
                row = {"set": name, "scene": scene, "seed": seed, **metrics}
                rows.append(row)
                out.write(json.dumps(row) + "\n")
            out.flush()
            print(name, scene, *(f"{m.get('iou', np.nan):.3f}" for m in job.result()), flush=True)
    return rows


def over_seeds(rows: Sequence[Mapping[str, Any]], name: str, key: str) -> list[float]:
    """The mean over the scenes of a set, seed by seed."""
    own = [row for row in rows if row["set"] == name and key in row]
    seeds = sorted({row["seed"] for row in own})
    return [float(np.mean([row[key] for row in own if row["seed"] == seed])) for seed in seeds]


def results(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """What the template of the page is given."""
    shown = []
    for name in names:
        for metric in METRICS:
            values = over_seeds(rows, name, metric.key)
            if metric.key not in SHOWN or not values:
                continue
            digits = metric.digits + 1 if metric.key != "bad2" else 4
            numbers = (np.mean(values), np.std(values, ddof=1), min(values), max(values))
            shown.append(
                {
                    "set": SETS[name],
                    "metric": metric,
                    "seeds": len(values),
                    "numbers": [f"{value:.{digits}f}" for value in numbers],
                }
            )
    metrics = [metric for metric in METRICS if metric.key in SHOWN]
    return {"rows": shown, "sets": [SETS[name] for name in names], "metrics": metrics}


SHEETS = ("office/pairs.json", *(f"places/{name}/pairs.json" for name in PLACES))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "data", type=data_folder(*SHEETS), help="folder that holds office and places, both labelled"
    )
    parser.add_argument("-o", "--out", type=Path, help="folder for the page seeds.md")
    parser.add_argument("--rows", type=Path, default=Path("seeds.jsonl"), help="kept rows")
    parser.add_argument("--only", nargs="+", choices=SETS, default=list(SETS), help="some sets")
    parser.add_argument("--workers", type=int, default=threads.cores())
    given = parser.parse_args()
    try:
        rows = measure(given.data, given.only, given.rows, given.workers)
    except InputError as error:
        parser.error(str(error))
    names = [name for name in given.only if over_seeds(rows, name, "psnr")]
    file = given.out and given.out / "seeds.md"
    publish("scores/seeds.md.j2", file, **results(rows, names))


if __name__ == "__main__":
    main()
