"""How right answers are: against other methods, and against what truth would make of each stage.

    python -m benches.scores.answer_scores DATA [-o docs/measured] [--rows FILE] [--only SET ...]

DATA holds ``office`` and ``places``; rooms are those that nothing was chosen on. Our own answers
are given with several seeds, which draw other ID codes, those of other methods once, on the same
Gaussians. Rows are kept in FILE as they come, and scenes that it holds are not done again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import SETS, SHEETS, built, over_seeds, read, truth_of
from flows.config import SceneSettings, Settings
from slgaussian.benchmark import metrics
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.answering import Answering
from slgaussian.benchmark.attribution import attribute_errors
from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.evaluate import EvaluationSettings, evaluate
from slgaussian.benchmark.protocols import load_protocol
from slgaussian.benchmark.scores import scene_means
from slgaussian.benchmark.statistics import compare, interval_of_mean
from slgaussian.errors import InputError
from slgaussian.kernels import threads

SHOWN = ("office", "places", "rooms")
SEEDS = 3
OURS, CUT = "slgaussian", "LangSplat's cut"
OTHERS = ("query-2d, depth", "no-bank")
PROTOCOLS = ("slgaussian", "langsplat", "threshold-free")
SCORES = {"iou": ("IoU", 3), "hit_mask": ("point", 2), "miou": ("mIoU", 3)}
STAGES = ("threshold", "language", "masks")

BEFORE: Mapping[str, Mapping[str, float]] = {
    "office": {"iou": 0.474, "hit_mask": 0.69, "miou": 0.46, "cut": 0.15},
    "places": {"iou": 0.31, "cut": 0.12},
    "rooms": {},
}
"""Figures of the start of this version's work, as they were written down then."""

DISTANCES = {"cut": ("answer to best threshold", "iou", "threshold_iou")}
"""What each is called, and the scores that it lies between."""


def scene_rows(name: str, scene: SceneSettings) -> Iterator[dict[str, Any]]:
    """A row a method and seed: means over what is asked in a scene."""
    sample = read(scene, Settings())
    truth = truth_of(scene, sample)
    # A labelled folder is one place; the office is one building, and each room one of its own.
    place = scene.dataset if name == "places" else scene.name
    common = {"set": name, "place": place, "scene": scene.name}
    first: Inputs | None = None
    for inputs in built(sample, range(SEEDS)):
        first = first or inputs
        lost = attribute_errors(inputs.field, inputs.gaussians, sample, truth)
        stages = {
            f"{stage}_iou": float(np.mean([row[f"{stage}_iou"] for row in lost]))
            for stage in STAGES
        }
        own = common | {"seed": inputs.seed, "queries": len(lost)}
        for method, scores in answers(inputs.field, inputs, truth).items():
            yield own | {"method": method} | scores | (stages if method == OURS else {})
    assert first is not None
    for method in OTHERS:
        scores = answers(ROWS[method].load()(first), first, truth)[OURS]
        yield common | {"seed": first.seed, "queries": len(lost), "method": method} | scores


def answers(answering: Answering, inputs: Inputs, truth: Truth) -> dict[str, dict[str, float]]:
    """The scores of what a method selects, and of LangSplat's cut of the same relevancies."""
    asked = EvaluationSettings(protocols=PROTOCOLS, drawn=False)
    rows = evaluate(answering, inputs.sample, inputs.label_maps, truth, asked).rows
    selected, cut, free = (
        [row for row in rows if row["protocol"] == load_protocol(name).label] for name in PROTOCOLS
    )
    for row in cut:
        point = None if row["point_x"] is None else (row["point_x"], row["point_y"])
        row["hit_mask"] = metrics.point_in_mask(point, truth.masks[row["frame"]][row["query"]])
    best = {"best_iou": scene_means(free)["best_iou"]}
    return {
        name: {score: mean for score, mean in scene_means(own).items() if score in SCORES} | best
        for name, own in ((OURS, selected), (CUT, cut))
    }


def measure(data: Path, names: Sequence[str], file: Path) -> list[dict[str, Any]]:
    """The rows of all scenes of these sets."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    there = {(row["set"], row["scene"]) for row in rows}
    for name in names:
        for scene in SETS[name].scenes(data):
            if (name, scene.name) in there:
                continue
            new = list(scene_rows(name, scene))
            with file.open("a") as out:
                out.writelines(json.dumps(row) + "\n" for row in new)
            rows += new
            said = (f"{row['method']} {row['iou']:.3f}" for row in new if row["seed"] == 0)
            print(name, scene.name, *said, sep="; ", flush=True)
    return rows


def by_scene(rows: Sequence[Mapping[str, Any]], key: str) -> dict[str, float]:
    """The mean over seeds of a score of each scene that has it."""
    found: dict[str, list[float]] = {}
    for row in rows:
        if key in row:
            found.setdefault(row["scene"], []).append(row[key])
    return {scene: float(np.mean(values)) for scene, values in found.items()}


def reached(own: Sequence[Mapping[str, Any]], name: str) -> list[dict[str, Any]]:
    """What we reach on a set: a row a score."""
    places = {row["scene"]: row["place"] for row in own}
    lines = []
    for key, (title, digits) in SCORES.items():
        seeds = over_seeds(own, name, key)
        means = by_scene(own, key)
        ends = interval_of_mean(np.array(list(means.values())), 0, [places[s] for s in means])
        line = {
            "set": name,
            "score": title,
            "mean": f"{np.mean(seeds):.{digits}f}",
            "deviation": f"{np.std(seeds, ddof=1):.{digits + 1}f}",
            "ends": f"{ends[0]:.{digits}f}–{ends[1]:.{digits}f}",
        }
        if key in BEFORE[name]:
            line["before"] = f"{BEFORE[name][key]:.{digits}f}".rstrip("0")
        lines.append(line)
    return lines


def compared(rows: Sequence[Mapping[str, Any]], name: str) -> list[dict[str, Any]]:
    """Us against the others on a set: a row a method and score that it has."""
    own = {method: [r for r in rows if r["method"] == method] for method in (OURS, CUT, *OTHERS)}
    places = {row["scene"]: row["place"] for row in own[OURS]}
    lines = []
    for method in (*OTHERS, CUT):
        for key, (title, digits) in SCORES.items():
            ours, theirs = by_scene(own[OURS], key), by_scene(own[method], key)
            if not theirs:
                continue
            gain = compare(
                [ours[scene] for scene in theirs],
                list(theirs.values()),
                groups=[places[scene] for scene in theirs],
            )
            lines.append(
                {
                    "set": name,
                    "method": method,
                    "score": title,
                    "theirs": f"{np.mean(list(theirs.values())):.{digits}f}",
                    "gain": f"{gain.difference:+.{digits}f}",
                    "ends": (gain.low, gain.high),
                    "beyond": "*" if gain.low > 0 or gain.high < 0 else "",
                }
            )
    return lines


def placed(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Place by place: means over the scenes of each, of us and of the others."""
    lines = []
    for place in dict.fromkeys(row["place"] for row in rows):
        here = [row for row in rows if row["place"] == place]
        line: dict[str, Any] = {"place": place, "queries": sum_of_queries(here)}
        for method in (OURS, CUT, *OTHERS):
            own = [row for row in here if row["method"] == method]
            for key in SCORES:
                means = list(by_scene(own, key).values())
                if means:
                    line[f"{method} {key}"] = float(np.mean(means))
        lines.append(line)
    return lines


def sum_of_queries(rows: Sequence[Mapping[str, Any]]) -> int:
    return sum({row["scene"]: row["queries"] for row in rows}.values())


def staged(own: Sequence[Mapping[str, Any]], name: str) -> dict[str, Any]:
    """Means over the queries of a set of what truth makes of each stage."""
    weights = [row["queries"] for row in own]
    keys = ("iou", *(f"{stage}_iou" for stage in STAGES), "best_iou")
    line: dict[str, Any] = {"set": name, "queries": sum_of_queries(own)}
    line |= {key: float(np.average([row[key] for row in own], weights=weights)) for key in keys}
    for distance, (_, low, high) in DISTANCES.items():
        line[distance] = line[high] - line[low]
        if distance in BEFORE[name]:
            line[f"{distance}_before"] = BEFORE[name][distance]
    return line


def results(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """What the template of the page is given."""
    found: dict[str, list] = {"reached": [], "compared": [], "stages": []}
    for name in names:
        here = [row for row in rows if row["set"] == name]
        own = [row for row in here if row["method"] == OURS]
        found["reached"] += reached(own, name)
        found["compared"] += compared(here, name)
        found["stages"].append(staged(own, name))
    halved = [
        f"{line['set']}, {title}"
        for line in found["stages"]
        for distance, (title, *_) in DISTANCES.items()
        if line[distance] <= line.get(f"{distance}_before", 0) / 2
    ]
    return {
        **found,
        "seeds": SEEDS,
        "halved": halved,
        "better": [called(line) for line in found["compared"] if line["ends"][0] > 0],
        "worse": [called(line) for line in found["compared"] if line["ends"][1] < 0],
        "places": placed([row for row in rows if row["set"] == "places"]),
        "sets": [SETS[name] for name in names],
    }


def called(line: Mapping[str, Any]) -> str:
    return f"{line['score']}, {line['set']}, against {line['method']} ({line['gain']})"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "data", type=data_folder(*SHEETS), help="folder that holds office and places, both labelled"
    )
    parser.add_argument("-o", "--out", type=Path, help="folder for the page answers.md")
    parser.add_argument("--rows", type=Path, default=Path("answers.jsonl"), help="kept rows")
    parser.add_argument("--only", nargs="+", choices=SHOWN, default=SHOWN, help="some sets")
    given = parser.parse_args()
    threads.limit(1)
    try:
        rows = measure(given.data, given.only, given.rows)
    except InputError as error:
        parser.error(str(error))
    file = given.out and given.out / "answers.md"
    publish("scores/answers.md.j2", file, **results(rows, given.only))


if __name__ == "__main__":
    main()
