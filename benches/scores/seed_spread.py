"""Scores with several seeds.

    python -m benches.scores.seed_spread DATA [-o docs/measured] [--rows FILE]

DATA holds ``office`` and ``places``. Every set of scenes is done with several seeds, as
``slgaussian benchmark --set seed=K`` does it. The page says the mean over scenes, and of that the
mean, deviation and extremes over seeds, and what comes out where BLAS uses the kernels of other
processors. Rows are kept in FILE as they come, and what it holds is not done again.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import SETS, SHEETS, built, over_seeds, read, truth_of
from flows.config import SceneSettings, Settings
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate
from slgaussian.benchmark.reports.scenes import METRICS
from slgaussian.errors import InputError
from slgaussian.kernels import threads

WIDE = "avx512f" in Path("/proc/cpuinfo").read_text()
KERNELS = ("Haswell", *(["SkylakeX"] if WIDE else []), "Zen")
"""Processors whose kernels OpenBLAS is told to use, by OPENBLAS_CORETYPE."""

SHOWN = ("iou", "hit_mask", "miou", "psnr", "ssim", "abs_rel", "bad2")


def scored(scene: SceneSettings, seeds: Sequence[int]) -> list[dict[str, float]]:
    """The metrics of a scene with each seed."""
    threads.limit(threads.cores())
    sample = read(scene, Settings())
    truth = truth_of(scene, sample)
    return [score(inputs, scene, truth) for inputs in built(sample, seeds)]


def score(inputs: Inputs, scene: SceneSettings, truth: Truth) -> dict[str, float]:
    """The metrics of a field of a scene."""
    asked = EvaluationSettings(queries=scene.queries, protocols=[Settings().protocol], drawn=False)
    result = evaluate(
        inputs.field,
        inputs.sample,
        inputs.label_maps,
        truth,
        asked,
        gaussians=inputs.gaussians,
    )
    return {key: float(value) for key, value in result.scene_metrics.items()}


def measure(data: Path, names: Sequence[str], file: Path, workers: int) -> list[dict[str, Any]]:
    """A row a set, scene and seed, of those named."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    rows = [row for row in rows if row["set"] != "kernels"]
    there = {(row["set"], row["scene"], row["seed"]) for row in rows}
    with (
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
        file.open("a") as out,
    ):
        jobs = {}
        for name in names:
            for scene in SETS[name].scenes(data):
                wanted = range(SETS[name].seeds)
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


def measure_kernels(data: Path, file: Path) -> list[dict[str, Any]]:
    """A row a kernel and pair, with seed 0. BLAS reads its environment once: a process a kernel."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    rows = [row for row in rows if row["set"] == "kernels"]
    there = {(row["kernel"], row["scene"]) for row in rows}
    for kernel in KERNELS:
        os.environ["OPENBLAS_CORETYPE"] = kernel
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            for scene in SETS["office"].scenes(data):
                if (kernel, scene.name) in there:
                    continue
                (metrics,) = pool.submit(scored, scene, [0]).result()
                row = {"set": "kernels", "kernel": kernel, "scene": scene.name, **metrics}
                rows.append(row)
                with file.open("a") as out:
                    out.write(json.dumps(row) + "\n")
                print(kernel, scene.name, metrics.get("iou"), flush=True)
    del os.environ["OPENBLAS_CORETYPE"]
    return rows


def by_kernel(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The means of each kernel, and by how much they differ at most."""
    metrics = [metric for metric in METRICS if metric.key in SHOWN and metric.key in rows[0]]
    means = {
        kernel: [np.mean([row[m.key] for row in rows if row["kernel"] == kernel]) for m in metrics]
        for kernel in KERNELS
    }
    spread = np.ptp(list(means.values()), 0).tolist()
    return {"metrics": metrics, "means": means, "spread": spread}


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
        kernels = by_kernel(measure_kernels(given.data, given.rows))
    except InputError as error:
        parser.error(str(error))
    names = [name for name in given.only if over_seeds(rows, name, "psnr")]
    file = given.out and given.out / "seeds.md"
    only = "" if given.only == list(SETS) else f" --only {' '.join(given.only)}"
    publish("scores/seeds.md.j2", file, only=only, kernels=kernels, **results(rows, names))


if __name__ == "__main__":
    main()
