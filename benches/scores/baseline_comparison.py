"""Scores and costs of every method of the benchmark.

    python -m benches.scores.baseline_comparison OUT DATA [-o docs/measured] [--only METHOD ...]

OUT is the output folder of a benchmark with ``--against``, which has scores and times. DATA holds
``office``; memory is measured on its first pair, in a separate process for each method. It needs
Linux, which reports the peak memory of a process.
"""

import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.harness import Format, parser, publish, table
from benches.common.photograph_pairs import data_folder
from benches.common.resident_memory import give_back, memory_status, reset_peak_memory
from slgaussian import datasets
from slgaussian.benchmark.annotations import read_truth
from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.costs import costs_of
from slgaussian.benchmark.index import read_index
from slgaussian.build import build_memory_bank, label_views, lift_field, predict
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.components.method import Method
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.masks import load_proposer

SETS = {"office": "office", "procedural": "rooms"}
"""Data sets, and their names in the table."""

SCORES = ("iou", "hit_mask", "miou")


def answers_of(out: Path) -> dict[str, dict]:
    """Return the scores of each method by data set."""
    scores_of: dict[str, dict] = {}
    for score in pq.read_table(out / "scores.parquet").to_pylist():
        of, metric = scores_of.setdefault(score["method"], {}), score["metric"]
        if score["protocol"].startswith("slgaussian@") and metric in SCORES:
            of[f"{score['dataset']}_{metric}"] = score["value"]
            if metric == "iou" and score["low"] is not None:
                of[f"{score['dataset']}_ends"] = f"{score['low']:.3f}–{score['high']:.3f}"
    return scores_of


def seconds_of(out: Path) -> dict[str, dict]:
    """Return the seconds of each method, medians over all scenes."""
    rows = pq.read_table(out / "times.parquet").to_pylist()
    return {
        cost.method: {
            "prepare": cost.prepare or 0.0,
            "first_query": cost.view_query or 0.0,
            "further_query": cost.further_query or 0.0,
        }
        for cost in costs_of({**row, "dataset": ""} for row in rows)
    }


def memory_of(name: str, data: Path) -> float:
    """Measure the peak memory of a method in a new process beyond one office field, MB."""
    words = [sys.executable, "-m", __spec__.name, "-", str(data), "--alone", name]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return float(done.stdout)


def run_alone(name: str, data: Path) -> None:
    scene = datasets.load("nerfstudio", data / "office")
    pair = read_index(data / "office" / "pairs.json").pairs[0]
    sample = scene.sample(list(pair.context), list(pair.targets))
    truth = read_truth(data / "office" / "labels", pair.categories, sample.targets).masks
    method = Method()
    graph = MatchGraph.of(sample.context)
    predicted = predict(sample, graph, method.predictor, method.seed)
    gaussians, geometry, quality, depths = predicted
    label_maps = label_views(geometry, method.proposer, method.tracker, method.replicas)
    bank = build_memory_bank(
        sample, geometry, label_maps, method.encoder, method.codes, method.seed
    )
    field = lift_field(sample, gaussians, label_maps, bank, method, quality, depths)
    field.encoder  # noqa: B018  (loaded once, for all)
    classes = tuple(sorted({text for masks in truth.values() for text in masks}))
    inputs = Inputs(sample, field, gaussians, label_maps, load_proposer("regions"), classes=classes)
    give_back()
    before = memory_status("VmRSS")
    reset_peak_memory()
    answering = ROWS[name].load()(inputs)
    for target in sample.targets:
        view = answering.render(target.camera)
        for text in truth[target.name]:
            try:
                (hit,) = view.query_all([text], **ROWS[name].rules)
            except InputError:  # not understood
                continue
            hit.mask, hit.relevancy, hit.point  # noqa: B018  (drawn when first looked at)
    print((memory_status("VmHWM") - before) / 2**20)


COLUMNS: dict[str, tuple[str, Format]] = {"method": ("method", str)}
for _set, _title in SETS.items():
    COLUMNS[f"{_set}_iou"] = (f"{_title}: IoU", ".3f")
    COLUMNS[f"{_set}_ends"] = ("interval", str)
    COLUMNS[f"{_set}_hit_mask"] = ("point", ".2f")
    COLUMNS[f"{_set}_miou"] = ("mIoU", ".3f")
COLUMNS |= {
    "prepare": ("prepare, s", ".3f"),
    "first_query": ("first query, s", ".3f"),
    "further_query": ("further, s", ".4f"),
    "memory": ("memory, MB", ".0f"),
}


def main() -> None:
    arguments = parser(__doc__, "answers.md")
    arguments.add_argument("run", type=Path, help="what the benchmark left")
    arguments.add_argument("data", type=data_folder("office/pairs.json"))
    arguments.add_argument("--only", nargs="*", metavar="METHOD")
    arguments.add_argument("--alone", help="used by itself")
    args = arguments.parse_args()
    threads.limit(1)
    if args.alone:
        run_alone(args.alone, args.data)
        return
    answers, costs = answers_of(args.run), seconds_of(args.run)
    rows = [
        {"method": name, **answers[name], **costs[name], "memory": memory_of(name, args.data)}
        for name in args.only or answers
    ]
    command = "python -m benches.scores.baseline_comparison OUT DATA"
    publish(args.out, "answers.md", command, table(rows, COLUMNS))


if __name__ == "__main__":
    main()
