"""Do objects keep their ids from one view to the other? Rows for ``mask_quality.py``.

Procedural pairs of several baselines have exact ids and get the plane sweep's depth, as in a run.
Of photographs with labels (``labels/`` in LERF-OVS JSON, of the target views of ``pairs.json``) the
sensor's depth tells where each labelled pixel of a target lies in both context views.

Of each object that both views see in 100 common pixels and more: ``matched`` is whether its main id
is one and the same in both views; ``alone`` also asks that no other object has that id for its main
one; ``iou`` is that of the object in the second view with the id it has in the first; ``pieces``
counts ids with 5 % of it or more; ``pixels`` is the share of its pixels seen by both views whose
ids agree. CPU seconds are of a pair: ``track`` without proposals, ``whole`` with them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from benches.common.photograph_pairs import SIZE, read_pairs
from slgaussian.benchmark.annotations import read_labels
from slgaussian.cameras.matches import sift_matches
from slgaussian.cameras.relative import Relative
from slgaussian.datasets import nerfstudio
from slgaussian.datasets.procedural import reader
from slgaussian.gaussians import source_depths
from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.masks import MaskTracker, Proposals, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.regions import Regions
from slgaussian.predict import load_predictor
from slgaussian.predict.pose import GATE, refine
from slgaussian.scene import Sample, View

BASELINES = (0.3, 0.6, 0.9, 1.2, 1.6)
"""In metres; the cameras stand about 3.3 m away from what they look at."""
OVERLAPS = (0, 0.6, 0.7, 0.8, 1)
"""Bounds of the shares of the first view that the second sees too, by which pairs are grouped."""
COPIES = (1, 3, 5, 7)
COMMON = 100
"""Fewest pixels that both views must see of an object."""
AGREE = 0.02
SENSOR_AGREE = 0.05
"""Relative depth within which two views see one point, by true depth and by a sensor's."""
LOST = 0.2
"""Share of the tiles that a noisy tracker loses at every look."""
PICTURED = (0, 4)
"""Seeds of the pairs in the picture: of the narrowest and of the widest baseline."""


@dataclass
class Cell:
    """What is averaged into one row: columns of objects, and seconds of pairs."""

    objects: list[dict[str, float]] = field(default_factory=list)
    seconds: list[tuple[float, float]] = field(default_factory=list)

    def row(self) -> dict[str, float]:
        means = {
            key: float(np.mean([columns[key] for columns in self.objects]))
            for key in self.objects[0]
            if key != "wall"
        }
        if "wall" in self.objects[0]:
            things = [columns["matched"] for columns in self.objects if not columns["wall"]]
            means["things"] = float(np.mean(things))
        track, whole = np.mean(self.seconds, 0)
        return {"objects": len(self.objects), **means, "track": track, "whole": whole}


Cells = dict[tuple, Cell]


class Once:
    """A proposer that does not propose again for a picture it knows; ``seconds`` says its time."""

    def __init__(self, propose: Callable[..., Proposals]) -> None:
        self.propose_now, self.known, self.seconds = propose, {}, 0.0

    def propose(self, seen, where=None):
        key = seen.image.tobytes(), None if where is None else where.tobytes()
        if key not in self.known:
            start = time.process_time()
            self.known[key] = self.propose_now(seen, where)
            self.seconds += time.process_time() - start
        return self.known[key]


def true_masks(views: tuple[View, ...]) -> Callable[..., Proposals]:
    """A proposer that knows the truth: errors that are left are those of the tracker."""
    instances = {view.image.tobytes(): view.instances for view in views}

    def propose(seen, where=None):
        ids = instances[seen.image.tobytes()]
        masks = ids == np.unique(ids[ids > 0])[:, None, None]
        return Proposals(masks, np.ones(len(masks), np.float32))

    return propose


class Noisy:
    """A tracker that is wrong in a new way at every look: each tile of 16 pixels may be lost."""

    final = False

    def __init__(self, tracker: MaskTracker, share: float) -> None:
        self.tracker, self.share, self.rng = tracker, share, np.random.default_rng(0)
        self.add = tracker.add

    def propagate(self, seen):
        labels = self.tracker.propagate(seen)
        rows, columns = (-(-size // 16) for size in labels.shape)
        lost = self.rng.random((rows, columns)) < self.share
        lost = np.kron(lost, np.ones((16, 16), bool))[: labels.shape[0], : labels.shape[1]]
        return np.where(lost, 0, labels)


def read_pair(seed: int) -> tuple[Sample, float]:
    baseline = BASELINES[seed % len(BASELINES)]
    scene = reader.read(seed, height=SIZE[0], width=SIZE[1], views=2, baseline=baseline)
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


def judge(sample: Sample, maps: LabelMaps) -> list[dict[str, float]]:
    """The columns of each object that both views see."""
    a, b = sample.context
    first, second = maps.labels
    row, column, seen = landing(a, b)
    common = np.bincount(a.instances[seen])
    objects = [i for i in np.flatnonzero(common >= COMMON).tolist() if i]
    mains = [main_ids(first, a.instances, objects), main_ids(second, b.instances, objects)]
    rows = []
    for number, here, there in zip(objects, *mains, strict=True):
        one, other = second == here, b.instances == number
        shares = [
            np.bincount(m[t]) / t.sum()
            for m, t in ((first, a.instances == number), (second, other))
        ]
        matched = here == there > 0
        columns = {
            "matched": matched,
            "alone": matched and all(main.count(here) == 1 for main in mains),
            "iou": (one & other).sum() / (one | other).sum() if here else 0.0,
            "pieces": float(np.mean([(share[1:] >= 0.05).sum() for share in shares])),
            "pixels": (first == second[row, column])[seen].mean(),
            "wall": any(word in sample.phrases[number] for word in ("wall", "ceiling")),
        }
        rows.append(columns)
    return rows


def run(
    sample: Sample,
    depths: np.ndarray,
    proposer: Once,
    tracker: MaskTracker,
    replicas: int = 5,
    back: MaskTracker | None = None,
) -> tuple[LabelMaps, tuple[float, float]]:
    """Label maps, and the seconds that they took, without proposals and with them."""
    start, before = time.process_time(), proposer.seconds
    seen = list(map(SeenView, sample.context, depths))
    maps = associate(seen, proposer, tracker, replicas, back)
    track = time.process_time() - start - (proposer.seconds - before)
    return maps, (track, track + proposer.seconds)


def procedural_cells(pairs: int) -> Iterator[tuple[dict[str, Cells], dict[int, dict]]]:
    """After every pair, the cells by table so far, and the label maps to be pictured by seed."""
    tables = {key: {} for key in ("trackers", "baselines", "overlaps", "copies")}
    pictured = {}
    for seed in range(pairs):
        sample, baseline = read_pair(seed)
        depths = predicted_depths(sample)
        regions, truth = Once(Regions().propose), Once(true_masks(sample.context))
        overlap = landing(*sample.context)[2].mean()
        bound = int(np.searchsorted(OVERLAPS, overlap, "right"))
        between = f"{OVERLAPS[bound - 1]} to {OVERLAPS[bound]}"

        def measure(proposer, tracker, *places, sample=sample, depths=depths, **settings):
            maps, seconds = run(sample, depths, proposer, tracker, **settings)
            columns = judge(sample, maps)
            for table, key in places:
                cell = tables[table].setdefault(key, Cell())
                cell.objects += columns
                cell.seconds.append(seconds)
            return maps

        shown = {}
        for name in ("geometric",):
            shown[name] = measure(
                regions,
                load_tracker(name),
                ("trackers", (name, "regions", "forth")),
                ("baselines", (name, baseline)),
                ("overlaps", (name, between)),
            )
            measure(truth, load_tracker(name), ("trackers", (name, "true masks", "forth")))
            back = load_tracker(name)
            place = "trackers", (name, "regions", "forth and back")
            measure(regions, load_tracker(name), place, back=back)
        if seed < max(1, pairs // 5):
            for replicas in COPIES:
                for name in ("geometric", "noisy"):
                    noisy = name == "noisy"
                    tracker = load_tracker("geometric" if noisy else name)
                    tracker = Noisy(tracker, LOST) if noisy else tracker
                    measure(regions, tracker, ("copies", (name, replicas)), replicas=replicas)
        if seed in PICTURED:
            pictured[seed] = sample, shown
        yield tables, pictured


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


def labelled_cells(folder: Path) -> tuple[Cells, dict[str, dict]]:
    """Cells by tracker, and the label maps by scene to be pictured."""
    scene = nerfstudio.read(folder)
    cells, pictured = {}, {}
    for scene_name, (context, target) in read_pairs(folder / "pairs.json").items():
        sample = scene.sample(context, target, size=SIZE)
        depths, once = predicted_depths(sample), Once(Regions().propose)
        places = labelled_points(sample, folder / "labels")
        shown = {}
        for name in ("geometric",):
            shown[name], seconds = run(sample, depths, once, load_tracker(name))
            cell = cells.setdefault((name,), Cell())
            cell.seconds.append(seconds)
            for a, b in places.values():
                here, there = shown[name].labels[0][a], shown[name].labels[1][b]
                mains = [np.bincount(ids).argmax() for ids in (here, there)]
                columns = {
                    "matched": mains[0] == mains[1] > 0,
                    "pixels": ((here == there) & (here > 0)).mean(),
                }
                cell.objects.append(columns)
        pictured[scene_name] = sample, shown
    return cells, pictured
