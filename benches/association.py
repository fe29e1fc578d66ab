"""Do objects keep their ids? ``python benches/association.py [--pairs N] [--data DIR] [-o PNG]``

Procedural pairs of five baselines have exact ids and get the plane sweep's depth, as in a run. DATA
is a folder with the camera file ``transforms.json``, ``pairs.json`` (scene -> context and target
views), sensor depth, and LERF-OVS labels of the targets in ``labels/``: the sensor tells where each
labelled pixel of a target lies in both context views. PNG shows one pair by every tracker.

Columns: ``matched`` is the share of objects, seen by both views in 100 common pixels and more,
whose main id is one and the same in both; ``things`` the same without walls and ceiling; ``alone``
also asks that no other object has that id for its main one; ``IoU`` is that of an object in the
second view with the id it has in the first; ``pieces`` counts ids with 5 % of an object or more;
``pixels`` is the share of pixels seen by both views whose ids agree. Seconds are those of the
processor, of a pair: ``track`` without proposals, ``whole`` with them.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from slgaussian.benchmark.labels import read_labels
from slgaussian.datasets import nerfstudio, procedural
from slgaussian.gaussians import source_depths
from slgaussian.labels import LabelMaps
from slgaussian.masks import MaskTracker, Proposals, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.regions import Regions
from slgaussian.predict import load_predictor
from slgaussian.predict.pose import GATE, Relative, refine, sift_matches
from slgaussian.scene import Sample, View

SIZE = (416, 576)
BASELINES = (0.3, 0.6, 0.9, 1.2, 1.6)
COMMON = 100
"""Fewest pixels that both views must see of an object."""
AGREE = 0.02
SENSOR_AGREE = 0.05
"""Relative depth within which two views see one point, by true depth and by a sensor's."""
PICTURED = 4
"""Seed of the pair in the picture: of the widest baseline."""
Columns = dict[str, float]


class Once:
    """A proposer that does not propose again for a picture it knows; ``seconds`` says its time."""

    def __init__(self, propose: Callable[..., Proposals]) -> None:
        self.propose_now, self.known, self.seconds = propose, {}, 0.0

    def propose(self, image, where=None, depth=None):
        key = image.tobytes(), None if where is None else where.tobytes()
        if key not in self.known:
            start = time.process_time()
            self.known[key] = self.propose_now(image, where, depth)
            self.seconds += time.process_time() - start
        return self.known[key]


def true_masks(views: tuple[View, ...]) -> Callable[..., Proposals]:
    """A proposer that knows: what is left to blame is the tracker."""
    instances = {view.image.tobytes(): view.instances for view in views}

    def propose(image, where=None, depth=None):
        ids = instances[image.tobytes()]
        masks = ids == np.unique(ids[ids > 0])[:, None, None]
        return Proposals(masks, np.ones(len(masks), np.float32))

    return propose


class Noisy:
    """A tracker that is wrong in a new way at every look: each tile of 16 pixels may be lost."""

    final = False

    def __init__(self, tracker: MaskTracker, share: float) -> None:
        self.tracker, self.share, self.rng = tracker, share, np.random.default_rng(0)
        self.add = tracker.add

    def propagate(self, view, depth=None):
        labels = self.tracker.propagate(view, depth)
        rows, columns = (-(-size // 16) for size in labels.shape)
        lost = self.rng.random((rows, columns)) < self.share
        lost = np.kron(lost, np.ones((16, 16), bool))[: labels.shape[0], : labels.shape[1]]
        return np.where(lost, 0, labels)


def read_pair(seed: int) -> tuple[Sample, float]:
    baseline = BASELINES[seed % len(BASELINES)]
    scene = procedural.read(seed, height=SIZE[0], width=SIZE[1], views=2, baseline=baseline)
    views = tuple(scene.read(name) for name in scene.cameras)
    return Sample(scene.name, views, (), scene.phrases), baseline


def predicted_depths(sample: Sample) -> np.ndarray:
    cameras = [view.camera for view in sample.context]
    return source_depths(load_predictor("planesweep")(sample), cameras)


def landing(a: View, b: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where ``a``'s pixels lie in ``b``: row, column, and whether both see the point there."""
    pixels, z = b.camera.project(a.camera.unproject(a.depth))
    column, row = np.floor(pixels).astype(int).transpose(2, 0, 1)
    inside = (z > 0) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    same = np.abs(b.depth[row, column] - z) < AGREE * z
    return row, column, inside & same & (b.instances[row, column] == a.instances)


def main_ids(labels: np.ndarray, truth: np.ndarray, objects: list[int]) -> list[int]:
    return [int(np.bincount(labels[truth == number]).argmax()) for number in objects]


def judge(sample: Sample, maps: LabelMaps) -> dict[int, Columns]:
    """The columns of each object that both views see."""
    a, b = sample.context
    first, second = maps.labels
    row, column, seen = landing(a, b)
    common = np.bincount(a.instances[seen])
    objects = [i for i in np.flatnonzero(common >= COMMON).tolist() if i]
    mains = [main_ids(first, a.instances, objects), main_ids(second, b.instances, objects)]
    rows = {}
    for number, here, there in zip(objects, *mains, strict=True):
        one, other = second == here, b.instances == number
        shares = [
            np.bincount(m[t]) / t.sum()
            for m, t in ((first, a.instances == number), (second, other))
        ]
        matched = here == there > 0
        rows[number] = {
            "matched": matched,
            "alone": matched and all(main.count(here) == 1 for main in mains),
            "IoU": (one & other).sum() / (one | other).sum() if here else 0.0,
            "pieces": float(np.mean([(share[1:] >= 0.05).sum() for share in shares])),
            "pixels": (first == second[row, column])[seen].mean(),
            "wall": any(word in sample.phrases[number] for word in ("wall", "ceiling")),
        }
    return rows


def table(title: str, rows: dict[str, list[Columns]]) -> None:
    print(f"\n{title}")
    names = [name for name in next(iter(rows.values()))[0] if name != "wall"]
    wide = max(map(len, rows))
    print(
        " " * wide, *(f"{name:>8}" for name in names), *(["  things"] if "matched" in names else [])
    )
    for label, found in rows.items():
        means = [np.mean([columns[name] for columns in found]) for name in names]
        things = [columns["matched"] for columns in found if not columns.get("wall")]
        means += [np.mean(things)] if "matched" in names else []
        print(f"{label:>{wide}}", *(f"{mean:8.3f}" for mean in means), flush=True)


def run(
    sample: Sample,
    depths: np.ndarray,
    proposer: Once,
    tracker: MaskTracker,
    replicas: int = 5,
    back: MaskTracker | None = None,
) -> tuple[LabelMaps, Columns]:
    """Label maps, and the seconds that they took."""
    start, before = time.process_time(), proposer.seconds
    maps = associate(sample.context, proposer, tracker, replicas, depths, back)
    track = time.process_time() - start - (proposer.seconds - before)
    return maps, {"track": track, "whole": track + proposer.seconds}


def procedural_tables(pairs: int, picture: Path | None) -> None:
    trackers: dict[str, list[Columns]] = {}
    baselines: dict[str, list[Columns]] = {}
    copies: dict[str, list[Columns]] = {}
    for seed in range(pairs):
        sample, baseline = read_pair(seed)
        depths = predicted_depths(sample)
        regions, truth = Once(Regions().propose), Once(true_masks(sample.context))
        shown = {}

        def add(rows, label, proposer, tracker, sample=sample, depths=depths, **settings):
            maps, seconds = run(sample, depths, proposer, tracker, **settings)
            columns = [{**c, **seconds} for c in judge(sample, maps).values()]
            rows.setdefault(label, []).extend(columns)
            return maps, columns

        for name in ("geometric", "flow"):
            add(trackers, f"{name}, truth", truth, load_tracker(name))
            shown[name], columns = add(trackers, f"{name}, regions", regions, load_tracker(name))
            baselines.setdefault(f"{name}, {baseline} m", []).extend(columns)
            both = load_tracker(name), load_tracker(name)
            add(trackers, f"{name}, regions, and back", regions, both[0], back=both[1])
        if seed < max(1, pairs // 5):
            for replicas in (1, 3, 5, 7):
                noisy = Noisy(load_tracker("geometric"), 0.2)
                for name, tracker in (
                    ("geometric", load_tracker("geometric")),
                    ("flow", load_tracker("flow")),
                    ("noisy", noisy),
                ):
                    label = f"{name}, {replicas} copies"
                    add(copies, label, regions, tracker, replicas=replicas)
        if picture and seed == PICTURED:
            draw(sample, shown, picture)
    table(f"{pairs} procedural pairs: tracker, proposals", trackers)
    table("by baseline (cameras stand 3.3 m away), regions", dict(sorted(baselines.items())))
    table(f"by copies, {max(1, pairs // 5)} pairs, regions", dict(sorted(copies.items())))


def labelled_points(sample: Sample, labels: Path) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
    """For each category the pixels (rows, columns) of both context views that show its points."""
    target = sample.targets[0]
    masks = read_labels(labels, Path(target.name).stem, SIZE[1], SIZE[0])
    grey = {v.name: cv2.cvtColor(v.image, cv2.COLOR_RGB2GRAY) for v in (target, *sample.context)}
    pixels = np.stack(np.meshgrid(np.arange(SIZE[1]) + 0.5, np.arange(SIZE[0]) + 0.5), -1)
    known, places = target.depth > 0, []
    for view in sample.context:
        given = Relative.between(target.camera, view.camera)
        a, b = sift_matches(grey[target.name], grey[view.name])
        close = np.abs(given.epipolar_distance(a, b)) < GATE * np.hypot(*SIZE)
        relative = refine(given, a[close], b[close])
        landed, ratio = relative.project(pixels, 1 / np.where(known, target.depth, 1))
        column, row = np.floor(landed).astype(int).transpose(2, 0, 1)
        inside = (ratio > 0) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        z, sensor = target.depth * ratio, view.depth[row, column]
        known = known & inside & (sensor > 0) & (np.abs(z - sensor) < SENSOR_AGREE * z)
        places.append((row, column))
    masks = {name: mask & known for name, mask in masks.items()}
    return {
        name: [(row[mask], column[mask]) for row, column in places]
        for name, mask in masks.items()
        if mask.sum() >= COMMON
    }


def labelled_table(folder: Path) -> None:
    scene = nerfstudio.read(folder)
    rows: dict[str, list[Columns]] = {}
    for pair in json.loads((folder / "pairs.json").read_text()).values():
        sample = scene.sample(pair["context"], pair["target"], size=SIZE)
        depths, once = predicted_depths(sample), Once(Regions().propose)
        places = labelled_points(sample, folder / "labels")
        for name in ("geometric", "flow"):
            maps, seconds = run(sample, depths, once, load_tracker(name))
            for a, b in places.values():
                here, there = maps.labels[0][a], maps.labels[1][b]
                mains = [np.bincount(ids).argmax() for ids in (here, there)]
                columns = {
                    "matched": mains[0] == mains[1] > 0,
                    "pixels": ((here == there) & (here > 0)).mean(),
                    **seconds,
                }
                rows.setdefault(name, []).append(columns)
    table(f"labelled pairs: {len(rows['flow'])} categories seen by both views", rows)


def draw(sample: Sample, found: dict[str, LabelMaps], file: Path) -> None:
    """Photographs, true ids, and the ids by each tracker, one colour an id, a view a row."""
    colors = np.random.default_rng(5).integers(50, 256, (4096, 3)).astype(np.uint8)
    colors[0] = 0
    columns = [np.concatenate([view.image for view in sample.context])]
    columns.append(np.concatenate([colors[view.instances] for view in sample.context]))
    columns += [
        np.concatenate([colors[labels] for labels in maps.labels]) for maps in found.values()
    ]
    Image.fromarray(np.concatenate(columns, 1)).reduce(2).save(file)
    print(f"{file}: photographs, true ids, {', '.join(found)}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--data", type=Path)
    parser.add_argument("-o", "--picture", type=Path)
    given = parser.parse_args()
    if given.pairs:
        procedural_tables(given.pairs, given.picture)
    if given.data:
        labelled_table(given.data)
