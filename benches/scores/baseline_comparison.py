"""What every method of the table answers, and what it costs, as a page:

python -m benches.scores.baseline_comparison OUT DATA [-o docs/measured] [--only METHOD ...]

OUT is what a benchmark with ``--against`` left: scores and times are its own. DATA holds
``office``; memory is measured on its first pair, in a process of its own for each method. Needs
Linux, which says how much memory a process held at most.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from slgaussian import datasets
from slgaussian.benchmark.annotations import read_truth
from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.costs import costs_of
from slgaussian.benchmark.index import read_index
from slgaussian.benchmark.resident_memory import forget_peak, give_back, held
from slgaussian.build import label_views, lift_field, predict, remember
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.components.method import Method
from slgaussian.errors import InputError
from slgaussian.geometry import SceneGeometry
from slgaussian.kernels import threads
from slgaussian.masks import load_proposer

SETS = {"office": "office", "procedural": "rooms"}
"""Data sets, and what the table calls them."""

SCORES = ("iou", "hit_mask", "miou")


def answers_of(out: Path) -> dict[str, dict]:
    """The scores of each method, by data set."""
    found: dict[str, dict] = {}
    for score in pq.read_table(out / "scores.parquet").to_pylist():
        of, metric = found.setdefault(score["method"], {}), score["metric"]
        if score["protocol"].startswith("slgaussian@") and metric in SCORES:
            of[f"{score['dataset']}_{metric}"] = score["value"]
            if metric == "iou" and score["low"] is not None:
                of[f"{score['dataset']}_ends"] = f"{score['low']:.3f}–{score['high']:.3f}"
    return found


def seconds_of(out: Path) -> dict[str, dict]:
    """The seconds of each method, medians over all scenes."""
    rows = pq.read_table(out / "times.parquet").to_pylist()
    found = {}
    for cost in costs_of({**row, "dataset": ""} for row in rows):
        prepare, first, further = (
            value or 0.0 for value in (cost.prepare, cost.view_query, cost.further_query)
        )
        known = {"prepare": prepare, "first_query": first, "further_query": further}
        found[cost.method] = known | {"ten": prepare + first + 9 * further}
    return found


def memory_of(name: str, data: Path) -> float:
    """What a fresh process comes to hold beyond the field of one office scene at most, MB."""
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
    gaussians, quality, depths = predict(sample, graph, method.predictor, method.seed)
    geometry = SceneGeometry.of(sample.context, gaussians)
    label_maps = label_views(geometry, method.proposer, method.tracker, method.replicas)
    bank = remember(sample, geometry, label_maps, method.encoder, method.codes, method.seed)
    field = lift_field(sample, gaussians, label_maps, bank, method, quality, depths)
    field.encoder  # noqa: B018  (loaded once, for all)
    classes = tuple(sorted({text for masks in truth.values() for text in masks}))
    inputs = Inputs(sample, field, gaussians, label_maps, load_proposer("regions"), classes=classes)
    give_back()
    before = held("VmRSS")
    forget_peak()
    answering = ROWS[name].load()(inputs)
    for target in sample.targets:
        view = answering.render(target.camera)
        for text in truth[target.name]:
            try:
                (hit,) = view.query_all([text], **ROWS[name].rules)
            except InputError:  # not understood
                continue
            hit.mask, hit.relevancy, hit.point  # noqa: B018  (drawn when first looked at)
    print((held("VmHWM") - before) / 2**20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="what the benchmark left")
    parser.add_argument("data", type=data_folder("office/pairs.json"))
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--only", nargs="*", metavar="METHOD")
    parser.add_argument("--alone", help=argparse.SUPPRESS)
    given = parser.parse_args()
    threads.limit(1)
    if given.alone:
        run_alone(given.alone, given.data)
        return
    answers, costs = answers_of(given.run), seconds_of(given.run)
    rows = []
    for name in given.only or answers:
        memory = {"memory": memory_of(name, given.data)}
        rows.append({"method": name} | answers[name] | costs[name] | memory)
    manifest = json.loads((given.run / "manifest.json").read_text())
    sets = [of["dataset"] for of in manifest["data"].values()]
    publish(
        "scores/methods.md.j2",
        given.out and given.out / "methods.md",
        rows=rows,
        costs=costs,
        settings=manifest["settings"],
        office=sets.count("office"),
        rooms=sets.count("procedural"),
    )


if __name__ == "__main__":
    main()
