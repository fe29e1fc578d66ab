"""Means over scenes of what settings cost and give, and which of them become presets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from slgaussian.benchmark.statistics import LEAST, compare

DEFAULT = ("defaults", "defaults")
"""Factor and name of the row that all others are compared with."""

NOISE = "seed"
PRUNED = "Gaussians kept"

KEPT_SHARE = 0.85
"""Of the defaults' IoU and mIoU that the preset `fast` keeps at least."""

HEADINGS = {"iou": "IoU", "miou": "mIoU", "abs_rel": "depth error"}
"""What is compared with the first row."""


MEANS = (
    "geometry", "masks", "supervision", "field", "build", "first", "further", "gaussians",
    "objects",
)  # fmt: skip


def summary(made: dict, first: dict) -> dict:
    """One row of the tables from what its scenes gave, compared with those of the defaults."""
    scenes, others = made["scenes"], first["scenes"]
    row: dict = {name: made[name] for name in ("factor", "name", "preset")}
    row |= {key: mean(scenes, key) for key in MEANS}
    row["share"] = row["build"] / mean(others, "build")
    row["memory"] = max(scene["memory"] for scene in scenes)
    for kind in ("office", "rooms"):
        own = [scene for scene in scenes if scene["kind"] == kind]
        for score in ("abs_rel", "psnr", "label_error", "iou", "hit", "miou"):
            value = mean(own, score)
            if not math.isnan(value):
                row[f"{kind}_{score}"] = value
    row |= {score: mean(scenes, score) for score in ("iou", "hit", "miou", "psnr", "abs_rel")}
    if made is not first and len(scenes) >= LEAST:
        for score in HEADINGS:
            found = compare([s[score] for s in scenes], [s[score] for s in others])
            row[f"{score}_gain"] = found.difference
            row[f"{score}_ends"] = found.low, found.high
            row[f"{score}_beyond"] = "*" if found.low > 0 or found.high < 0 else ""
    return row


def mean(scenes: Sequence[dict], key: str) -> float:
    values = [scene[key] for scene in scenes if key in scene]
    return float(np.mean(values)) if values else math.nan


def summaries(made: Sequence[dict]) -> list[dict]:
    """The rows of all scenes."""
    return [summary(one, made[0]) for one in made if one["factor"] != PRUNED]


def pruned(made: Sequence[dict]) -> list[dict]:
    """The rows of one scene, and the first row on the same."""
    own = [one for one in made if one["factor"] == PRUNED]
    if not own:
        return []
    names = {scene["scene"] for scene in own[0]["scenes"]}
    first = made[0] | {"scenes": [s for s in made[0]["scenes"] if s["scene"] in names]}
    return [summary(one, first) for one in (first, *own)]


def picked(rows: Sequence[dict]) -> dict[str, dict]:
    """The row of each preset, by the rules that the page puts into words."""
    first = rows[0]
    good = [
        row
        for row in rows
        if row["factor"] not in (NOISE, "precision")
        and all(row[score] >= KEPT_SHARE * first[score] for score in ("iou", "miou"))
    ]
    return {"fast": min(good, key=whole_seconds), "balanced": first}


def whole_seconds(row: dict) -> float:
    """From photographs to the first answer."""
    return row["build"] + row["first"]


def worse_scores(row: dict) -> list[str]:
    """Those beyond noise."""
    return [
        score
        for score in HEADINGS
        if row.get(f"{score}_beyond") and (row[f"{score}_gain"] > 0) == (score == "abs_rel")
    ]


def better_scores(row: dict) -> list[str]:
    """Those beyond noise."""
    worse = worse_scores(row)
    return [score for score in HEADINGS if row.get(f"{score}_beyond") and score not in worse]


def accurate(rows: Sequence[dict]) -> list[dict]:
    """Rows whose answers are better beyond noise and that are worse in nothing."""
    return [
        row
        for row in rows
        if row["factor"] not in (NOISE, "precision")
        and {"iou", "miou"} & set(better_scores(row))
        and not worse_scores(row)
    ]


def beyond_noise(rows: Sequence[dict]) -> tuple[list[str], list[str]]:
    """Single changes that are worse, and those that are better, with the scores that say so."""
    singles = [row for row in rows if row["factor"] not in ("together", NOISE, DEFAULT[0])]
    worse, better = [], []
    for row in singles:
        for scores, told in ((worse_scores(row), worse), (better_scores(row), better)):
            if scores:
                listed = ", ".join(HEADINGS[score] for score in scores)
                told.append(f"{called(row)} ({listed})")
    return worse, better


def called(row: dict) -> str:
    return f"{row['factor']}: {row['name']}"


def results(made: Sequence[dict]) -> dict[str, Any]:
    """What the template of the page is given."""
    rows = summaries(made)
    kinds = [scene["kind"] for scene in made[0]["scenes"]]
    worse, better = beyond_noise(rows)
    return {
        "rows": rows,
        "kept": pruned(made),
        "office": kinds.count("office"),
        "rooms": kinds.count("rooms"),
        "presets": picked(rows),
        "headings": HEADINGS,
        "kept_share": KEPT_SHARE,
        "accurate": [called(row) for row in accurate(rows)],
        "seeds": [row["iou"] for row in rows if row["factor"] in (NOISE, DEFAULT[0])],
        "worse": worse,
        "better": better,
    }
