"""What every method of the table answers, and what it costs: on office pairs and procedural rooms.

python benches/methods.py DATA [-o docs] [--rooms 4] [--scenes 8]

DATA holds ``office``. All methods answer from the same photographs, Gaussians, masks and encoder,
by the default rules. Times are processor seconds of all cores together, after one scene that does
not count; each method prepares from scratch what it needs beyond the field. Memory is measured in a
process of its own for each method.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from machine import machine
from tables import Table, count, hundredths, thousandths

from slgaussian import datasets, threads
from slgaussian.benchmark import metrics
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.benchmark.index import read_index
from slgaussian.benchmark.labels import read_truth
from slgaussian.benchmark.methods import ROWS
from slgaussian.benchmark.methods.inputs import Inputs
from slgaussian.build import label_views, lift_field, remember
from slgaussian.errors import InputError
from slgaussian.masks import load_proposer
from slgaussian.predict import load_predictor
from slgaussian.scene import Sample

SIZE = (416, 576)
OBJECTS = 8
SEED = 100

ANSWERS = Table(
    "Answers",
    "Means over all queries of the target views, by the protocol `slgaussian` and default rules: "
    "IoU, share of points in the mask, and the IoU of the closed-set segmentation by all of them.",
    {
        "method": ("method", str),
        "office_iou": ("office IoU", thousandths),
        "office_hit": ("point", hundredths),
        "office_miou": ("mIoU", thousandths),
        "room_iou": ("rooms IoU", thousandths),
        "room_hit": ("point", hundredths),
        "room_miou": ("mIoU", thousandths),
    },
)
COSTS = Table(
    "Costs",
    "Processor seconds, medians over the scenes. *Prepare* is what a method does beyond the field; "
    "*first query* is rendering a new view and one text; *further* is each text after that, asked "
    "alone. *Memory* is what a process comes to hold beyond the field at most, MB, while it "
    "prepares and answers one office scene.",
    {
        "method": ("method", str),
        "prepare": ("prepare, s", thousandths),
        "first": ("first query, s", thousandths),
        "further": ("further, s", thousandths),
        "scene": ("10 queries of a scene, s", hundredths),
        "memory": ("memory, MB", count),
    },
)


@dataclass(frozen=True, eq=False)
class Case:
    """A scene with its truth: masks by target view and text."""

    kind: str
    sample: Sample
    truth: dict[str, dict[str, np.ndarray]]

    @property
    def texts(self) -> list[str]:
        return sorted({text for masks in self.truth.values() for text in masks})


def office(data: Path, most: int) -> Iterator[Case]:
    scene = datasets.load("nerfstudio", data / "office")
    for pair in read_index(data / "office" / "pairs.json").pairs[:most]:
        sample = scene.sample(list(pair.context), list(pair.targets)).resized(*SIZE)
        truth = read_truth(data / "office" / "labels", pair.categories, sample.targets)
        yield Case("office", sample, truth.masks)


def rooms(most: int) -> Iterator[Case]:
    for number in range(most):
        scene = datasets.load(
            "procedural", seed=SEED + number, objects=OBJECTS, views=3, height=SIZE[0],
            width=SIZE[1],
        )  # fmt: skip
        sample = scene.sample(["view_00", "view_02"], ["view_01"])
        yield Case("room", sample, truth_from_instances(sample))


def prepare(case: Case) -> Callable[[], Inputs]:
    """The field of a scene; returns what makes inputs that share nothing but it."""
    gaussians = load_predictor("planesweep")(case.sample)
    label_maps = label_views(case.sample, gaussians, "regions", "geometric", 5, {})
    bank = remember(case.sample, gaussians, label_maps, "lexicon", "separated", 0)
    about = {"encoder": "lexicon", "codes": "separated", "lifting": "hard"}
    field = lift_field(case.sample, gaussians, label_maps, bank, "hard", about)
    field.encoder  # noqa: B018  (loaded once, for all)
    proposer, classes = load_proposer("regions"), tuple(case.texts)
    return lambda: Inputs(case.sample, field, label_maps, proposer, classes=classes)


def measure(row: str, case: Case, inputs: Inputs) -> dict[str, list[float]]:
    """Scores and times of one method on one scene; InputError if it cannot be run."""
    found: dict[str, list[float]] = {
        name: [] for name in ("iou", "hit", "miou", "first", "further")
    }
    start = time.process_time()
    answering = ROWS[row].load()(inputs)
    found["prepare"] = [time.process_time() - start]
    for target in case.sample.targets:
        masks = {text: mask for text, mask in case.truth[target.name].items() if mask.any()}
        start, view = time.process_time(), None
        for text, mask in masks.items():
            view = view or answering.render(target.camera)
            try:
                (hit,) = view.query_all([text])
                given, point = hit.mask, hit.point
            except InputError:  # not understood
                given, point = np.zeros_like(mask), None
            now = time.process_time()
            found["first" if not found["first"] else "further"].append(now - start)
            found["iou"].append(metrics.iou(given, mask))
            found["hit"].append(metrics.point_in_mask(point, mask))
            start = time.process_time()
        known = [text for text in masks if understood(view, text)]
        labels = view.segment(known)
        places = np.array([0, *(1 + list(masks).index(text) for text in known)])
        found["miou"] += metrics.class_ious(places[labels], list(masks.values()))
    return found


def understood(view, text: str) -> bool:
    try:
        view.reader.unknown_words(text)
    except InputError:
        return False
    return True


def compare(cases: Sequence[Case], names: Sequence[str]) -> list[dict]:
    results: dict[str, list[tuple[str, dict]]] = {name: [] for name in names}
    refused = set()
    for number, case in enumerate(cases):
        fresh = prepare(case)
        for name in names:
            try:
                if number == 0:
                    measure(name, case, fresh())  # compiles kernels
                results[name].append((case.kind, measure(name, case, fresh())))
            except InputError as problem:
                if name not in refused:
                    print(f"{name}: not run ({problem})", file=sys.stderr)
                refused.add(name)
        print(f"{case.kind} {case.sample.scene}", file=sys.stderr)
    return [summary(name, found) for name, found in results.items() if found]


def summary(name: str, results: Sequence[tuple[str, dict]]) -> dict:
    row: dict = {"method": name}
    for kind in ("office", "room"):
        for score in ("iou", "hit", "miou"):
            values = [value for k, found in results if k == kind for value in found[score]]
            if values:
                row[f"{kind}_{score}"] = float(np.mean(values))
    for key in ("prepare", "first", "further"):
        row[key] = float(np.median([value for _, found in results for value in found[key]]))
    row["scene"] = row["prepare"] + row["first"] + 9 * row["further"]
    return row


def memory_of(name: str, data: Path) -> float:
    """What a fresh process comes to hold beyond the field of one office scene at most, MB."""
    words = [sys.executable, __file__, str(data), "--alone", name]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return float(done.stdout)


def run_alone(name: str, data: Path) -> None:
    case = next(office(data, 1))
    inputs = prepare(case)()
    before = kilobytes("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    measure(name, case, inputs)
    print((kilobytes("VmHWM") - before) / 1024)


def kilobytes(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--only", nargs="*", default=list(ROWS), metavar="METHOD")
    parser.add_argument("--no-memory", action="store_true")
    parser.add_argument("--alone", help=argparse.SUPPRESS)
    given = parser.parse_args()
    threads.share(1)
    if given.alone:
        run_alone(given.alone, given.data)
        return
    cases = [*office(given.data, given.scenes), *rooms(given.rooms)]
    rows = compare(cases, given.only)
    if not given.no_memory:
        for row in rows:
            row["memory"] = memory_of(row["method"], given.data)
    asked = {kind: sum(c.kind == kind for c in cases) for kind in ("office", "room")}
    lines = [
        "# Methods, measured",
        f"Made by `python benches/methods.py DATA --rooms {given.rooms} --scenes {given.scenes}` "
        f"on {machine()}: {asked['office']} office pairs, {asked['room']} procedural rooms, "
        f"{SIZE[0]} x {SIZE[1]}, encoder `lexicon`, proposer `regions`.",
        ANSWERS.markdown(rows),
        COSTS.markdown(rows),
    ]
    page = "\n\n".join(lines)
    print(page)
    if given.out:
        (given.out / "methods_measured.md").write_text(page + "\n")


if __name__ == "__main__":
    main()
