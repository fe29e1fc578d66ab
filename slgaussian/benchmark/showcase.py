"""Which answers a report shows in pictures: the worst before the best, and one by all methods."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from slgaussian.benchmark import pictures

Row = Mapping[str, Any]
Key = tuple[str, str, str]
"""Scene, frame and query."""

WORST = 8
"""Answers of a run, those that scored least, that open the report."""

BEST = 4
"""Answers of a run, those that scored most, that follow."""

OF_A_SCENE = 2
"""Shown answers that are of one scene at most, unless there are too few scenes; as many are of each
data set."""

ALL_METHODS = 5
"""Queries that are shown as every method answers them."""

MISS = 0.5
"""IoU below which an answer counts as missed."""


def key_of(row: Row) -> Key:
    """Which question a row is of."""
    return row["scene"], row["frame"], row["query"]


def leading(rows: Sequence[Row]) -> list[Row]:
    """The rows of the first protocol, by whose answers a report shows pictures."""
    return [row for row in rows if row["protocol"] == rows[0]["protocol"]]


def ranked(rows: Iterable[Row]) -> list[Row]:
    """The scored rows, worst first: by IoU, and of equal ones those that also point elsewhere."""
    scored = [row for row in rows if row["iou"] is not None]
    return sorted(scored, key=lambda row: (row["iou"], bool(row["hit_mask"]), bool(row["hit_box"])))


def few_a_scene(rows: Sequence[Row], count: int) -> list[Row]:
    """The first ``count`` rows, no more than a few of any scene, and of each data set its share.

    A query is there once a scene, whatever the number of frames that it is asked in.
    """
    sets, scenes = (len({row[of] for row in rows}) or 1 for of in ("dataset", "scene"))
    own = {"scene": max(OF_A_SCENE, -(-count // scenes))}
    taken: Counter[tuple[str, str]] = Counter()
    chosen: dict[tuple[str, str], int] = {}
    # Where a data set has not its share, the others fill the places.
    for most in (own | {"dataset": -(-count // sets)}, own):
        for place, row in enumerate(rows):
            asked = row["scene"], row["query"]
            full = any(taken[of, row[of]] >= limit for of, limit in most.items())
            if len(chosen) < count and not full and asked not in chosen:
                taken.update((of, row[of]) for of in ("scene", "dataset"))
                chosen[asked] = place
    return [rows[place] for place in sorted(chosen.values())]


def telling(own: Sequence[Row], others: Mapping[str, Sequence[Row]], count: int) -> list[Key]:
    """The queries that tell methods apart: where others are ahead of ours, then behind.

    Those where the best of the others is farthest ahead, and where the mean of them is farthest
    behind; none where there are no others. All rows are of one protocol.
    """
    mine = {key_of(row): row["iou"] for row in own if row["iou"] is not None}
    by_key: dict[Key, list[float]] = {key: [] for key in mine}
    for rows in others.values():
        for row in rows:
            if key_of(row) in by_key and row["iou"] is not None:
                by_key[key_of(row)].append(row["iou"])
    asked = {key: ious for key, ious in by_key.items() if ious}
    lost = sorted(asked, key=lambda key: mine[key] - max(asked[key]))
    won = sorted(asked, key=lambda key: float(np.mean(asked[key])) - mine[key])
    behind = _once([key for key in lost if mine[key] < max(asked[key])], [])[: (count + 1) // 2]
    ahead = _once([key for key in won if mine[key] > np.mean(asked[key])], behind)
    return behind + ahead[: count - len(behind)]


def _once(keys: Sequence[Key], before: Sequence[Key]) -> list[Key]:
    """The keys whose text was not shown in another frame of the scene, nor ``before``."""
    shown = {(scene, query) for scene, _, query in before}
    fresh: dict[tuple[str, str], Key] = {}
    for key in keys:
        if (key[0], key[2]) not in shown:
            fresh.setdefault((key[0], key[2]), key)
    return list(fresh.values())


def outlined(photo: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The photograph uint8 [H, W, 3] with the outline of the true mask bool [H, W]."""
    return pictures.draw_outline(photo, truth, pictures.TRUE)


def answered(photo: np.ndarray, truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """What was found, bool [H, W], bright in the photograph, with both outlines."""
    lit = pictures.draw_outline(pictures.spotlight(photo, found), found, pictures.PREDICTED)
    return pictures.draw_outline(lit, truth, pictures.TRUE)
