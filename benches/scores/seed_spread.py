"""Scores with several seeds.

    python -m benches.scores.seed_spread DATA [-o docs/measured] [--rows FILE]

DATA holds ``office`` and ``places``. Each set of scenes is measured with several seeds, as by
``slgaussian benchmark --set seed=K``. The table has the mean over scenes, and its mean, deviation
and extremes over seeds. Rows are appended to FILE, and scenes in it are not measured again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import (
    SETS,
    SHEETS,
    build_fields,
    over_seeds,
    read,
    read_truth_of_scene,
)
from flows.config import SceneSettings, Settings
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate
from slgaussian.benchmark.reports.score_tables import METRICS
from slgaussian.errors import InputError
from slgaussian.kernels import threads

SEEDS = 3
SHOWN = ("iou", "hit_mask", "miou", "psnr", "ssim", "abs_rel", "bad2")


def score_seeds(scene: SceneSettings, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Compute the metrics of a scene with each seed."""
    threads.limit(threads.cores())
    sample = read(scene, Settings())
    truth = read_truth_of_scene(scene, sample)
    return [score(inputs, scene, truth) for inputs in build_fields(sample, seeds)]


def score(inputs: Inputs, scene: SceneSettings, truth: Truth) -> dict[str, float]:
    """Compute the metrics of a field of a scene."""
    settings = EvaluationSettings(queries=scene.queries, protocols=["slgaussian"], drawn=False)
    result = evaluate(
        inputs.field,
        inputs.sample,
        inputs.label_maps,
        truth,
        settings,
        gaussians=inputs.gaussians,
    )
    return {key: float(value) for key, value in result.scene_metrics.items()}


def measure(data: Path, names: Sequence[str], file: Path, workers: int) -> list[dict[str, Any]]:
    """Return a row per set, scene and seed of the named sets."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    measured = {(row["set"], row["scene"], row["seed"]) for row in rows}
    with (
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
        file.open("a") as out,
    ):
        jobs = {}
        for name in names:
            for scene in SETS[name].scenes(data):
                seeds = [k for k in range(SEEDS) if (name, scene.name, k) not in measured]
                if seeds:
                    jobs[pool.submit(score_seeds, scene, seeds)] = name, scene.name, seeds
        for job in as_completed(jobs):
            name, scene, seeds = jobs[job]
            for seed, metrics in zip(seeds, job.result(), strict=True):
                row = {"set": name, "scene": scene, "seed": seed, **metrics}
                rows.append(row)
                out.write(json.dumps(row) + "\n")
            out.flush()
            print(name, scene, *(f"{m.get('iou', np.nan):.3f}" for m in job.result()), flush=True)
    return rows


COLUMNS = {
    "set": ("scenes", str),
    "chosen": ("constants chosen on it", str),
    "metric": ("metric", str),
    "seeds": ("seeds", "d"),
    "mean": ("mean", str),
    "deviation": ("deviation", str),
    "least": ("least", str),
    "most": ("most", str),
}


def summary(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return a row per set and metric: the mean over scenes, and its spread over seeds."""
    lines = []
    for name in names:
        for metric in METRICS:
            values = over_seeds(rows, name, metric.metric)
            if metric.metric not in SHOWN or not values:
                continue
            digits = metric.digits + 1 if metric.metric != "bad2" else 4
            numbers = (np.mean(values), np.std(values, ddof=1), min(values), max(values))
            lines.append(
                {
                    "set": name,
                    "chosen": "yes" if SETS[name].chosen else "no",
                    "metric": metric.title,
                    "seeds": len(values),
                    **{
                        key: f"{value:.{digits}f}"
                        for key, value in zip(list(COLUMNS)[4:], numbers, strict=True)
                    },
                }
            )
    return lines


def main() -> None:
    arguments = parser(__doc__, "results.md")
    arguments.add_argument("data", type=data_folder(*SHEETS), help="office and places, labelled")
    arguments.add_argument("--rows", type=Path, default=Path("seeds.jsonl"), help="kept rows")
    arguments.add_argument("--only", nargs="+", choices=SETS, default=list(SETS), help="some sets")
    arguments.add_argument("--workers", type=int, default=threads.cores())
    args = arguments.parse_args()
    try:
        rows = measure(args.data, args.only, args.rows, args.workers)
    except InputError as error:
        arguments.error(str(error))
    command = f"python -m benches.scores.seed_spread DATA --only {' '.join(args.only)}"
    publish(args.out, "results.md", command, table(summary(rows, args.only), COLUMNS))


if __name__ == "__main__":
    main()
