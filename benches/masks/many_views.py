"""Objects over many views: do they keep their ids, and what do they cost? A page.

    python -m benches.masks.many_views [--rooms 4] [-o docs/measured]

Made-up rooms with exact ids and depth, at 416 x 576: views of one arc between the same two ends,
in the order of the arc and shuffled, labelled by the tracker alone and with the votes of all views.
Costs are of one room, with true masks in the place of proposals, each in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import SIZE
from benches.masks.id_consistency import Once, judge, true_masks
from slgaussian.datasets.procedural import reader
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.kernels.seeding import rng_for
from slgaussian.language import load_codes, load_encoder
from slgaussian.language.bank import build_bank
from slgaussian.masks import load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.levels import group_objects
from slgaussian.masks.regions import Regions
from slgaussian.scene import Sample, View

ARC = 1.6
"""Metres between the two ends."""
PLACES = {2: (0, 7), 4: (0, 2, 5, 7), 8: tuple(range(8))}
"""Which of eight views of the arc are looked at."""
COST = (2, 8, 20, 50)


def objects_whole(views: Sequence[View], labels: np.ndarray) -> list[float]:
    """IoU, over all views together, of each object with the id that most of it has."""
    truth = np.stack([view.instances for view in views])
    found = []
    for number in np.unique(truth[truth > 0]):
        mine = truth == number
        ids = np.bincount(labels[mine])
        ids[0] = 0
        main = labels == ids.argmax()
        found.append((mine & main).sum() / (mine | main).sum() if ids.any() else 0.0)
    return found


def tracker_alone(seen: Sequence[SeenView], labels: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """What stands in for the votes to see what they are worth."""
    return labels


def labelled(seen: list[SeenView], order: np.ndarray, proposer: Once, votes: bool) -> np.ndarray:
    """Labels int32 [V, H, W] of views that were told in an order, in their own."""
    settle = patch("slgaussian.masks.associate.settle", tracker_alone)
    told = [seen[k] for k in order]
    if votes:
        maps = associate(told, proposer, load_tracker())
    else:
        with settle:
            maps = associate(told, proposer, load_tracker())
    labels = np.empty_like(maps.labels)
    labels[order] = maps.labels
    return labels


class _Pair:
    def __init__(self, labels: np.ndarray) -> None:
        self.labels = labels


def rows_of_room(seed: int, once: Callable[..., Once]) -> list[dict]:
    """A row for each number of views, order and way."""
    scene = reader.read(seed, height=SIZE[0], width=SIZE[1], views=8, baseline=ARC)
    arc = [scene.read(name) for name in scene.cameras]
    proposer, rows = once(), []
    for count, places in PLACES.items():
        views = [arc[k] for k in places]
        seen = [SeenView(view, view.depth) for view in views]
        for order in ("arc", "shuffled"):
            told = np.arange(count)
            if order == "shuffled":
                told = np.random.default_rng(seed).permutation(count)
            for votes in (False, True):
                labels = labelled(seen, told, proposer, votes)
                pairs = [
                    judge(
                        Sample(scene.name, (views[a], views[b]), (), scene.phrases),
                        _Pair(labels[[a, b]]),
                    )
                    for a in range(count)
                    for b in range(a + 1, count)
                ]
                judged = [row for pair in pairs for row in pair]
                rows.append(
                    {
                        "views": count,
                        "order": order,
                        "way": "all views vote" if votes else "tracker alone",
                        **{
                            key: float(np.mean([row[key] for row in judged]))
                            for key in ("matched", "alone", "pixels")
                        },
                        "whole": float(np.mean(objects_whole(views, labels))),
                        "ids": float(len(np.unique(labels[labels > 0]))),
                    }
                )
    return rows


def averaged(rows: list[dict]) -> list[dict]:
    """Means over rooms, and the spread of the IoU between them."""
    keys = list(dict.fromkeys((row["views"], row["order"], row["way"]) for row in rows))
    found = []
    for key in keys:
        mine = [row for row in rows if (row["views"], row["order"], row["way"]) == key]
        means = {name: float(np.mean([row[name] for row in mine])) for name in list(mine[0])[3:]}
        spread = float(np.std([row["whole"] for row in mine]))
        found.append(dict(zip(("views", "order", "way"), key, strict=True)) | means)
        found[-1]["spread"] = spread
    return found


def cost(count: int) -> dict:
    """Seconds of the masks and of the bank of ``count`` views, in this process."""
    scene = reader.read(0, height=SIZE[0], width=SIZE[1], views=count, baseline=2.0)
    views = tuple(scene.read(name) for name in scene.cameras)
    geometry = SceneGeometry(tuple(SeenView(view, view.depth) for view in views))
    start = time.process_time()
    proposer = Once(true_masks(views))
    maps = associate(geometry.seen, proposer, load_tracker())
    masks = time.process_time() - start
    codes = load_codes()(maps, rng_for(0, scene.name, "codes"))
    groups, start = group_objects(geometry.seen, maps), time.process_time()
    bank = build_bank(views, maps, load_encoder(), codes, geometry.surroundings, groups)
    return {
        "views": count,
        "objects": len(bank),
        "masks": masks,
        "bank": time.process_time() - start,
        "features": bank.features.nbytes / 2**20,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=4, help="made-up rooms, by seed from 0")
    parser.add_argument("--cost", type=int, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--out", type=Path, help="folder for many_views_masks.md")
    given = parser.parse_args()
    if given.cost:
        print(json.dumps(cost(given.cost)))
        return
    rows = []
    for seed in range(given.rooms):
        rows += rows_of_room(seed, lambda: Once(Regions().propose))
        print(f"room {seed + 1} of {given.rooms}", flush=True)
    program = [sys.executable, "-m", "benches.masks.many_views", "--cost"]
    costs = []
    for count in COST:
        said = subprocess.run([*program, str(count)], capture_output=True, text=True, check=True)
        costs.append(json.loads(said.stdout.splitlines()[-1]))
    publish(
        "masks/many_views.md.j2",
        given.out and given.out / "many_views_masks.md",
        rows=averaged(rows),
        costs=costs,
        rooms=given.rooms,
        command=f"python -m benches.masks.many_views --rooms {given.rooms} -o docs/measured",
    )


if __name__ == "__main__":
    main()
