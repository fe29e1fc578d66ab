"""Speed against error, setting by setting.

    python -m benches.scores.setting_tradeoffs DATA [-o docs/measured]

DATA holds ``office``. One setting is changed at a time, from the defaults; a few rows change
several. The presets are picked among the rows by the rules of ``tradeoff_summary``. Two processes
share the scenes, one thread each. Seconds are those of the processor, after a small run that does
not count. A stage is computed once for all rows that need the same of it, and they all say what it
took then. Needs Linux, which says how much memory a process held at most.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import count, islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.scores.tradeoff_chart import chart
from benches.scores.tradeoff_summary import DEFAULT, NOISE, PRUNED, results
from flows.settings import PRESETS, Method, Settings, make_settings
from slgaussian import datasets
from slgaussian.benchmark import metrics
from slgaussian.benchmark.annotations import read_truth
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.benchmark.index import read_index
from slgaussian.benchmark.resident_memory import forget_peak, give_back, held
from slgaussian.build import label_views, lift_field, predict, remember
from slgaussian.cameras import trajectories
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField
from slgaussian.geometry import SceneGeometry
from slgaussian.kernels import threads
from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.parts.part import Part
from slgaussian.rasterize import prune
from slgaussian.scene import Sample, Scene, Size, View

ROOM = {"objects": 8, "views": 3, "height": 520, "width": 720}
"""Larger than what is taken by default, as photographs mostly are."""

SEED = 100
"""Of the first room."""

GREY = 1 / 255
BUILDING = ("geometry", "masks", "supervision", "field")
EXACT = Part.of("codes", "exact")


@dataclass(frozen=True)
class Row:
    """What is changed from the defaults.

    ``keep`` is the tolerance at which Gaussians are pruned, as the photographs see them or, if
    ``between``, a view halfway too; ``precision`` a name of :data:`PRECISIONS`. None of these is a
    setting of a run. A ``slow`` row is for one scene alone.
    """

    factor: str
    name: str
    values: dict[str, Any] = field(default_factory=dict)
    keep: float | None = None
    between: bool = False
    precision: str | None = None

    @property
    def slow(self) -> bool:
        return self.keep is not None

    @property
    def settings(self) -> Settings:
        return make_settings(self.values, self.name)


def rows() -> Iterator[Row]:
    yield Row(*DEFAULT)
    for size in ("at most 208x288", "at most 312x432", "original"):
        yield Row("size", size, {"size": size})
    for most in (32, 64, 216):
        own = {"planesweep": {"depth_candidates": most}}
        yield Row("depth candidates", f"at most {most}", own)
    for greys, between in ((1, False), (4, False), (4, True)):
        seen = "photographs and halfway" if between else "photographs"
        name = f"{greys} of 255, {seen}"
        yield Row(PRUNED, name, {"keep": "all"}, greys * GREY, between)
    yield Row("Gaussians", "all", {"keep": "all"})
    yield Row("replicas", "geometric, 1", {"replicas": 1})
    for copies in (1, 5):
        yield Row("replicas", f"flow, {copies}", {"tracker": "flow", "replicas": copies})
    yield Row("codes", "grid, 3 numbers", {"codes": "grid"})
    for numbers in (1, 2, "auto"):
        own = {"separated": {"dimension": numbers}}
        yield Row("codes", f"separated, {numbers}", own)
    yield Row("codes", "exact", {"codes": "exact"})
    yield Row("lifting", "filled", {"lifting": "filled"})
    for precision in PRECISIONS:
        yield Row("precision", precision, precision=precision)
    for seed in (1, 2):
        yield Row(NOISE, str(seed), {"seed": seed})
    for size, most in TOGETHER:
        own = {"planesweep": {"depth_candidates": most}} if most else {}
        name = f"{size}, exact" + (f", {most} depths" if most else "")
        yield Row("together", name, {"size": size, "codes": "exact", **own})


TOGETHER = (
    ("at most 208x288", 64),
    ("at most 208x288", None),
    ("at most 312x432", None),
    ("original", None),
    ("original", 216),
)
"""Sizes and depth candidates that are also tried together, without codes."""


# Precisions that are no settings.


def coarser(features: np.ndarray) -> np.ndarray:
    """As 8 bits a number could hold unit vectors; brought to length 1 again."""
    top = np.abs(features).max(-1, keepdims=True)
    steps = np.rint(features / np.where(top, top, 1) * 127)
    length = np.linalg.norm(steps, axis=-1, keepdims=True)
    return (steps / np.where(length, length, 1)).astype(np.float32)


def bank_of_bytes(made: SemanticField) -> SemanticField:
    groups = made.bank.group_features
    features = {"features": coarser(made.bank.features)}
    if groups is not None:
        features["group_features"] = coarser(groups)
    return made.changed(bank=replace(made.bank, **features))


def half_gaussians(made: SemanticField) -> SemanticField:
    rounded = {
        name: array.half().float() if array.dtype == torch.float32 else array
        for name, array in made.gaussians.items()
    }
    return made.changed(gaussians=replace(made.gaussians, **rounded))


PRECISIONS: dict[str, Callable[[SemanticField], SemanticField]] = {
    "bank 8 bits": bank_of_bytes,
    "Gaussians float16": half_gaussians,
}
"""What is done to a finished field, whose bank holds float16 and whose Gaussians float32."""


# Scenes.


@dataclass(frozen=True, eq=False)
class Case:
    """A scene: its views at any size, and the truth at the size that is the default."""

    kind: str
    read: Callable[[Size], Sample]
    judged: Sample
    truth: dict[str, dict[str, np.ndarray]]


def office(data: Path) -> Iterator[Case]:
    scene = datasets.load("nerfstudio", data / "office")
    for pair in read_index(data / "office" / "pairs.json").pairs:
        read = partial(read_views, pair.scene, scene, pair.context, pair.targets)
        sample = read("auto")
        truth = read_truth(data / "office" / "labels", pair.categories, sample.targets)
        yield Case("office", read, sample, truth.masks)


def rooms(_: Path) -> Iterator[Case]:
    for number in count():
        scene = datasets.load("procedural", seed=SEED + number, **ROOM)
        read = partial(read_views, scene.name, scene, ("view_00", "view_02"), ("view_01",))
        sample = read("auto")
        yield Case("rooms", read, sample, truth_from_instances(sample).masks)


CASES = {"office": office, "rooms": rooms}


def read_views(
    name: str, scene: Scene, context: Sequence[str], targets: Sequence[str], size: Size
) -> Sample:
    return replace(scene.sample(context, targets, size), scene=name)


# Stages and what they cost.


@dataclass(frozen=True)
class Cost:
    """Processor seconds, and MB that were held at most beyond those before."""

    seconds: float
    memory: float


def measured(work: Callable[[], Any]) -> tuple[Any, Cost]:
    give_back()
    forget_peak()
    before = held("VmRSS")
    start = time.process_time()
    result = work()
    seconds = time.process_time() - start
    return result, Cost(seconds, (held("VmHWM") - before) / 2**20)


class Stages:
    """The stages of one scene, each computed once for what it depends on."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self._known: dict[str, tuple[Any, Cost]] = {}

    def once(self, given: Sequence[Any], work: Callable[[], Any]) -> tuple[Any, Cost]:
        key = repr(given)
        if key not in self._known:
            self._known[key] = measured(work)
        return self._known[key]

    def build(self, row: Row) -> Built:
        chosen, method = row.settings, row.settings.built_by
        sample = self.case.read(chosen.size)
        shape = sample.context[0].image.shape
        predictor = method.predictor
        (gaussians, quality, depths), geometry = self.once(
            ["geometry", shape, predictor],
            lambda: predict(sample, predictor, chosen.seed, trust_cameras=True),
        )
        masks_of = method.proposer, method.tracker, chosen.replicas
        seen = SceneGeometry.of(sample.context, gaussians)
        labels, masks = self.once(
            ["masks", shape, predictor, masks_of], lambda: label_views(seen, *masks_of)
        )
        # What is encoded depends on the labels alone, and codes take their part besides.
        same = hashlib.sha256(labels.labels.tobytes()).hexdigest()
        bare, encoding = self.once(
            ["supervision", shape, predictor, same],
            lambda: remember(sample, seen, labels, method.encoder, EXACT, 0),
        )
        strategy = method.codes.load()
        codes, drawing = self.once(
            ["codes", method.codes, method.seed, same],
            lambda: strategy(labels, rng_for(method.seed, sample.content, "codes")),
        )
        bank = replace(bare, codes=codes)

        def lift() -> SemanticField:
            made = lift_field(sample, gaussians, labels, bank, method, quality, depths)
            if row.keep is not None:
                cameras = [view.camera for view in sample.context]
                cameras += [trajectories.between(*cameras[:2], 0.5)] * row.between
                made = made.changed(gaussians=prune(made.gaussians, cameras, row.keep).gaussians)
            return made if row.precision is None else PRECISIONS[row.precision](made)

        made, lifting = measured(lift)  # anew: a field remembers what it has made
        made.encoder  # noqa: B018  (loaded before anything is timed)
        supervision = Cost(encoding.seconds + drawing.seconds, max(encoding.memory, drawing.memory))
        costs = dict(zip(BUILDING, (geometry, masks, supervision, lifting), strict=True))
        return Built(sample, labels, made, costs)


@dataclass(frozen=True, eq=False)
class Built:
    """The views of a row, their labels, the field, and what each stage took."""

    sample: Sample
    labels: LabelMaps
    field: SemanticField
    costs: dict[str, Cost]


# Answers and what they are worth.


def brought(array: np.ndarray, like: View, smooth: bool = False) -> np.ndarray:
    """An image at the size of a view: the nearest pixel, or smoothly."""
    height, width = like.image.shape[:2]
    if array.shape[:2] == (height, width):
        return array
    shrinks = cv2.INTER_AREA if array.shape[0] > height else cv2.INTER_CUBIC
    how = shrinks if smooth else cv2.INTER_NEAREST_EXACT
    plain = array.astype(np.uint8) if array.dtype == bool else array
    return cv2.resize(plain, (width, height), interpolation=how).astype(array.dtype)


def judge(case: Case, sample: Sample, made: SemanticField, main: np.ndarray) -> dict[str, float]:
    """Scores of the answers in the target views, brought to the size of the truth, and costs."""
    found: dict[str, list[float]] = {}
    seen: dict[str, Cost] = {}

    def note(name: str, value: float) -> None:
        found.setdefault(name, []).append(float(value))

    for target, truth in zip(sample.targets, case.judged.targets, strict=True):
        masks = {text: m for text, m in sorted(case.truth[target.name].items()) if m.any()}
        first = next(text for text in masks if understood(made, text))

        def ask_first(camera=target.camera, first=first) -> FieldView:
            view = made.render(camera)
            view.query(first).point  # noqa: B018  (worked out when first looked at)
            return view

        view, seen["first"] = measured(ask_first)
        start, asked = time.process_time(), 0
        for text, mask in masks.items():
            given, point = np.zeros_like(mask), None
            if understood(made, text):
                hit = view.query(text)
                given, point, asked = hit.mask, hit.point, asked + 1
            note("iou", metrics.iou(brought(given, truth), mask))
            note("hit", metrics.point_in_mask(scaled(point, target, truth), mask))
        note("further", (time.process_time() - start) / max(asked, 1))
        known = [text for text in masks if understood(made, text)]
        places = np.array([0, *(1 + list(masks).index(text) for text in known)])
        labels = brought(places[view.segment(known)].astype(np.int32), truth)
        for value in metrics.class_ious(labels, list(masks.values())):
            note("miou", value)
        note("psnr", metrics.psnr(brought(view.rgb, truth, smooth=True), truth.image))
        if truth.depth is not None:
            errors = metrics.depth_errors(brought(view.depth, truth), truth.depth)
            note("abs_rel", errors["abs_rel"])
        if truth.instances is not None:
            note("label_error", wrong_labels(brought(view.ids, truth), truth.instances, main))
    means = {name: float(np.mean(values)) for name, values in found.items()}
    return means | {"first": seen["first"].seconds, "first_memory": seen["first"].memory}


def understood(made: SemanticField, text: str) -> bool:
    try:
        made.reader.unknown_words(text)
    except InputError:
        return False
    return True


def scaled(point: tuple[float, float] | None, of: View, to: View) -> tuple[float, float] | None:
    if point is None:
        return None
    (h, w), (height, width) = of.image.shape[:2], to.image.shape[:2]
    return point[0] * width / w, point[1] * height / h


def main_ids(sample: Sample, labels: np.ndarray) -> np.ndarray:
    """The id that most pixels of each true instance have in the context views, by instance."""
    if sample.context[0].instances is None:
        return np.zeros(0, np.int32)
    true = np.stack([view.instances for view in sample.context])
    shape = int(true.max()) + 1, int(labels.max()) + 1
    votes = np.bincount((true * shape[1] + labels).ravel(), minlength=shape[0] * shape[1])
    votes = votes.reshape(shape)
    votes[:, 0] = 0
    return votes.argmax(1)


def wrong_labels(ids: np.ndarray, instances: np.ndarray, main: np.ndarray) -> float:
    """Share of the pixels of things that a context view shows whose id is another one."""
    known = (instances > 0) & (instances < len(main))
    return float(np.mean(ids[known] != main[instances[known]]))


def measure(stages: Stages, row: Row) -> dict[str, Any]:
    """Costs and scores of a row on a scene."""
    built = stages.build(row)
    main = main_ids(built.sample, built.labels.labels)
    scores = judge(stages.case, built.sample, built.field, main)
    seconds = {stage: cost.seconds for stage, cost in built.costs.items()}
    most = max(scores.pop("first_memory"), *(cost.memory for cost in built.costs.values()))
    return {
        "kind": stages.case.kind,
        "scene": stages.case.judged.scene,
        **scores,
        **seconds,
        "build": sum(seconds.values()),
        "memory": most,
        "gaussians": len(built.field.gaussians),
        "objects": len(built.field.bank),
    }


def sweep_scene(data: Path, kind: str, number: int, factors: Sequence[str]) -> list[dict | None]:
    """What each row gives on one scene; None for those that it is not for."""
    case = next(islice(CASES[kind](data), number, None))
    warm(case)
    stages = Stages(case)
    chosen = chosen_rows(factors)
    first = (kind, number) == ("office", 0)
    return [None if row.slow and not first else measure(stages, row) for row in chosen]


@lru_cache(1)
def ready() -> list[None]:
    """Filled by the first scene of a process."""
    return []


def warm(case: Case) -> None:
    """Compile kernels and load what is loaded once."""
    if not ready():
        stages, small = Stages(case), {"size": "at most 104x144"}
        for values in ({}, {"tracker": "flow"}, {"codes": "exact"}, {"codes": "grid"}):
            measure(stages, Row("", "", small | values))
        ready().append(None)


def chosen_rows(factors: Sequence[str]) -> list[Row]:
    return [row for row in rows() if not factors or row.factor in (DEFAULT[0], *factors)]


def sweep(data: Path, counts: dict[str, int], factors: Sequence[str]) -> list[dict]:
    """Each row with what every scene gave: ``{"factor", "name", "scenes"}``."""
    work = [(kind, number) for kind, most in counts.items() for number in range(most)]
    # What takes longest first.
    work.sort(key=lambda one: (one != ("office", 0), one[0] != "rooms"))
    made: list[dict] = [
        {"factor": row.factor, "name": row.name, "scenes": []} for row in chosen_rows(factors)
    ]
    with ProcessPoolExecutor(2, get_context("spawn"), threads.limit, (threads.cores(),)) as pool:
        done = {pool.submit(sweep_scene, data, *one, factors): one for one in work}
        for finished in as_completed(done):
            print("{} {} done".format(*done[finished]), file=sys.stderr, flush=True)
        for finished in sorted(done, key=done.get):
            for row, result in zip(made, finished.result(), strict=True):
                row["scenes"] += [] if result is None else [result]
    return made


def preset_of(row: Row) -> str:
    """The preset with the same settings, or nothing."""
    if row.keep is not None or row.precision is not None:
        return ""
    same = [name for name in PRESETS if method_of({"preset": name}) == method_of(row.values)]
    return same[0] if same else ""


def method_of(values: dict[str, Any]) -> dict[str, Any]:
    return make_settings(values, "tradeoffs").model_dump(include=set(Method.model_fields))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=data_folder("office/pairs.json"))
    parser.add_argument("-o", "--out", type=Path, help="folder for tradeoffs.md and .svg")
    parser.add_argument("--scenes", type=int, default=8, help="of the office set")
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--only", nargs="*", default=[], help="factors, beside the defaults")
    parser.add_argument("--keep", type=Path, help="JSON of what was measured, written, or read")
    given = parser.parse_args()
    if given.keep and given.keep.exists():
        made = json.loads(given.keep.read_text())
    else:
        made = sweep(given.data, {"office": given.scenes, "rooms": given.rooms}, given.only)
        if given.keep:
            given.keep.write_text(json.dumps(made))
    presets = {(row.factor, row.name): preset_of(row) for row in rows()}
    made = [{**one, "preset": presets[one["factor"], one["name"]]} for one in made]
    command = (
        "python -m benches.scores.setting_tradeoffs DATA "
        f"--scenes {given.scenes} --rooms {given.rooms}"
    )
    file = given.out and given.out / "tradeoffs.md"
    publish("scores/tradeoffs.md.j2", file, command=command, **results(made))
    if given.out:
        (given.out / "tradeoffs.svg").write_bytes(chart(made))


if __name__ == "__main__":
    main()
