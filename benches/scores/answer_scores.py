"""Scores of answers, compared with other methods and with ground truth for each stage.

    python -m benches.scores.answer_scores DATA [-o docs/measured] [--rows FILE] [--only SET ...]

DATA holds ``office``, ``places`` and ``things``; rooms are those on which no constant was chosen.
Our method runs with several seeds, which draw different ID codes; other methods run once, on the
same Gaussians. Rows are appended to FILE, and scenes in it are not measured again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.harness import Format, parser, publish, table
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
from slgaussian.language.lexicon import Lexicon

SHOWN = ("things", "office", "places", "rooms")
SEEDS = 3
OURS, CUT = "slgaussian", "LangSplat's cut"
OTHERS = ("query-2d, depth", "no-bank")
PROTOCOLS = ("slgaussian", "langsplat")
SCORES = {"iou": ("IoU", 3), "hit_mask": ("point", 2), "miou": ("mIoU", 3)}
STAGES = ("threshold", "language", "masks")
LEXICON = Lexicon()
SMALL = 0.015
"""Fraction of the image below which an object is small."""
SURFACES = {"floor", "wall", "ceiling", "carpet", "rug", "tiles", "grass", "lawn", "sky", "street",
            "road", "pavement", "cloth", "tablecloth"}  # fmt: skip
KINDS = ("noun", "described noun", "surface", "small")


def scene_rows(name: str, scene: SceneSettings) -> Iterator[dict[str, Any]]:
    """Return a row per method and seed: means over the queries of a scene."""
    sample = read(scene, Settings())
    truth = read_truth_of_scene(scene, sample)
    # A labelled folder is one place, but each scene of the office and each room is a place too.
    place = scene.dataset if name in ("places", "things") else scene.name
    common = {"set": name, "place": place, "scene": scene.name}
    first: Inputs | None = None
    for inputs in build_fields(sample, range(SEEDS)):
        first = first or inputs
        lost = attribute_errors(inputs.field, inputs.gaussians, sample, truth)
        stages = {
            f"{stage}_iou": float(np.mean([row[f"{stage}_iou"] for row in lost]))
            for stage in STAGES
        }
        summary = common | {"seed": inputs.seed, "queries": len(lost)}
        for method, scores in answers(inputs.field, inputs, truth).items():
            yield summary | {"method": method} | scores | (stages if method == OURS else {})
    assert first is not None
    for method in OTHERS:
        scores = answers(ROWS[method].load()(first), first, truth)[OURS]
        yield common | {"seed": first.seed, "queries": len(lost), "method": method} | scores


def find_kind(text: str, mask: np.ndarray) -> str:
    """Return the kind, of :data:`KINDS`, of a text with true mask bool [H, W]."""
    if mask.mean() < SMALL:
        return "small"
    if text.split()[-1] in SURFACES:
        return "surface"
    return "described noun" if LEXICON.understand(text).describing else "noun"


def answers(answering: Answering, inputs: Inputs, truth: Truth) -> dict[str, dict[str, Any]]:
    """Return the scores of a method's selection, and of LangSplat's cut of its relevancies.

    ``kinds`` are the IoUs of the texts of each kind.
    """
    settings = EvaluationSettings(protocols=PROTOCOLS, drawn=False)
    rows = evaluate(answering, inputs.sample, inputs.label_maps, truth, settings).rows
    selected, cut = (
        [row for row in rows if row["protocol"] == load_protocol(name).label] for name in PROTOCOLS
    )
    for row in cut:
        point = None if row["point_x"] is None else (row["point_x"], row["point_y"])
        row["hit_mask"] = metrics.point_in_mask(point, truth.masks[row["frame"]][row["query"]])
    means = {}
    for name, own_rows in ((OURS, selected), (CUT, cut)):
        kinds: dict[str, list[float]] = {}
        for row in own_rows:
            mask = truth.masks[row["frame"]][row["query"]]
            kinds.setdefault(find_kind(row["query"], mask), []).append(row["iou"])
        scores = {score: mean for score, mean in scene_means(own_rows).items() if score in SCORES}
        means[name] = scores | {"kinds": kinds}
    return means


def measure(data: Path, names: Sequence[str], file: Path) -> list[dict[str, Any]]:
    """Return the rows of all scenes of these sets, measured or read from ``file``."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    measured = {(row["set"], row["scene"]) for row in rows}
    for name in names:
        for scene in SETS[name].scenes(data):
            if (name, scene.name) in measured:
                continue
            new = list(scene_rows(name, scene))
            with file.open("a") as out:
                out.writelines(json.dumps(row) + "\n" for row in new)
            rows += new
            cells = (f"{row['method']} {row['iou']:.3f}" for row in new if row["seed"] == 0)
            print(name, scene.name, *cells, sep="; ", flush=True)
    return rows


def by_scene(rows: Sequence[Mapping[str, Any]], key: str) -> dict[str, float]:
    """Return the mean over seeds of a score, for each scene that has it."""
    values_of: dict[str, list[float]] = {}
    for row in rows:
        if key in row:
            values_of.setdefault(row["scene"], []).append(row[key])
    return {scene: float(np.mean(values)) for scene, values in values_of.items()}


def summarise_ours(our_rows: Sequence[Mapping[str, Any]], name: str) -> list[dict[str, Any]]:
    """Return our scores on a set, one row per score."""
    places = {row["scene"]: row["place"] for row in our_rows}
    lines = []
    for key, (title, digits) in SCORES.items():
        seeds = over_seeds(our_rows, name, key)
        means = by_scene(our_rows, key)
        ends = interval_of_mean(np.array(list(means.values())), [places[s] for s in means])
        lines.append(
            {
                "set": name,
                "score": title,
                "mean": f"{np.mean(seeds):.{digits}f}",
                "deviation": f"{np.std(seeds, ddof=1):.{digits + 1}f}",
                "ends": f"{ends[0]:.{digits}f}–{ends[1]:.{digits}f}",
            }
        )
    return lines


def compare_with_others(rows: Sequence[Mapping[str, Any]], name: str) -> list[dict[str, Any]]:
    """Return our gains over the others on a set, paired by scene, one row per method."""
    of = {method: [r for r in rows if r["method"] == method] for method in (OURS, CUT, *OTHERS)}
    places = {row["scene"]: row["place"] for row in of[OURS]}
    lines = []
    for method in (*OTHERS, CUT):
        line = {"set": name, "method": method}
        for key, (_, digits) in SCORES.items():
            ours, theirs = by_scene(of[OURS], key), by_scene(of[method], key)
            if theirs:
                gain = compare(
                    [ours[scene] for scene in theirs],
                    list(theirs.values()),
                    groups=[places[scene] for scene in theirs],
                )
                star = " *" if gain.low > 0 or gain.high < 0 else ""
                ends = f"({gain.low:+.{digits}f} to {gain.high:+.{digits}f})"
                line[key] = f"{gain.difference:+.{digits}f} {ends}{star}"
        lines.append(line)
    return lines


def average_by_place(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return means over the scenes of each place, for our method and the others."""
    lines = []
    for place in dict.fromkeys(row["place"] for row in rows):
        here = [row for row in rows if row["place"] == place]
        line: dict[str, Any] = {"place": place, "queries": sum_of_queries(here)}
        for method in (OURS, CUT, *OTHERS):
            of_method = [row for row in here if row["method"] == method]
            for key in SCORES:
                means = list(by_scene(of_method, key).values())
                if means:
                    line[f"{method} {key}"] = float(np.mean(means))
        lines.append(line)
    return lines


def by_kind(rows: Sequence[Mapping[str, Any]], name: str) -> list[dict[str, Any]]:
    """Return the mean IoU by kind of text on a set, for our method and the others."""
    lines = []
    for kind in KINDS:
        ious: dict[str, list[float]] = {}
        for row in rows:
            ious.setdefault(row["method"], []).extend(row["kinds"].get(kind, []))
        if ious.get(OURS):
            counted = len(ious[OURS]) // SEEDS
            means = {method: float(np.mean(values)) for method, values in ious.items()}
            lines.append({"set": name, "kind": kind, "texts": counted, **means})
    return lines


def sum_of_queries(rows: Sequence[Mapping[str, Any]]) -> int:
    return sum({row["scene"]: row["queries"] for row in rows}.values())


def average_by_stage(our_rows: Sequence[Mapping[str, Any]], name: str) -> dict[str, Any]:
    """Return means over the queries of a set with ground truth for each stage."""
    weights = [row["queries"] for row in our_rows]
    keys = ("iou", *(f"{stage}_iou" for stage in STAGES))
    line: dict[str, Any] = {"set": name, "queries": sum_of_queries(our_rows)}
    return line | {
        key: float(np.average([r[key] for r in our_rows], weights=weights)) for key in keys
    }


REACHED = {
    "set": ("set", str),
    "score": ("score", str),
    "mean": ("mean", str),
    "deviation": ("deviation over seeds", str),
    "ends": ("interval over places", str),
}
PLACED: dict[str, tuple[str, Format]] = {"place": ("place", str), "queries": ("queries", "d")}
PLACED |= {f"{OURS} {key}": (title, f".{digits}f") for key, (title, digits) in SCORES.items()}
for _method in (*OTHERS, CUT):
    PLACED[f"{_method} iou"] = (f"{_method}: IoU", ".3f")
    PLACED[f"{_method} hit_mask"] = ("point", ".2f")
BY_KIND: dict[str, tuple[str, Format]] = {
    "set": ("set", str),
    "kind": ("kind of word", str),
    "texts": ("texts", "d"),
    **{method: (f"{method}: IoU", ".3f") for method in (OURS, *OTHERS, CUT)},
}
GAINS = {"set": ("set", str), "method": ("gain over", str)}
GAINS |= {key: (title, str) for key, (title, _) in SCORES.items()}
STAGED: dict[str, tuple[str, Format]] = {"set": ("set", str), "queries": ("queries", "d")}
STAGED |= {
    "iou": ("as it is", ".3f"),
    "threshold_iou": ("best threshold", ".3f"),
    "language_iou": ("whole things", ".3f"),
    "masks_iou": ("true masks", ".3f"),
}


def main() -> None:
    arguments = parser(__doc__, "answers.md")
    arguments.add_argument("data", type=data_folder(*SHEETS), help="labelled sets")
    arguments.add_argument("--rows", type=Path, default=Path("answers.jsonl"), help="kept rows")
    arguments.add_argument("--only", nargs="+", choices=SHOWN, default=SHOWN, help="some sets")
    args = arguments.parse_args()
    threads.limit(1)
    try:
        rows = measure(args.data, args.only, args.rows)
    except InputError as error:
        arguments.error(str(error))
    sets = {name: [row for row in rows if row["set"] == name] for name in args.only}
    ours = {name: [r for r in some if r["method"] == OURS] for name, some in sets.items()}
    publish(
        args.out,
        "answers.md",
        "python -m benches.scores.answer_scores DATA",
        table([line for name in sets for line in summarise_ours(ours[name], name)], REACHED),
        table([line for name, some in sets.items() for line in by_kind(some, name)], BY_KIND),
        table(average_by_place([*sets.get("things", []), *sets.get("places", [])]), PLACED),
        table(
            [line for name, some in sets.items() for line in compare_with_others(some, name)], GAINS
        ),
        table([average_by_stage(our_rows, name) for name, our_rows in ours.items()], STAGED),
    )


if __name__ == "__main__":
    main()
