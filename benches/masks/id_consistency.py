"""Consistency of object ids across views: pairs of views, many views, and photographs.

    python -m benches.masks.id_consistency DATA [-o docs/measured] [--pairs 50] [--rooms 3]

Pairs of procedural rooms, with several baselines, have exact ids and the plane sweep's depth, as in
a run. Views on an arc have exact depth, and are processed in order and shuffled. DATA is a folder
of labelled pairs of photographs with sensor depth, which maps each labelled pixel of a target into
both context views.

Columns for objects with at least 100 pixels visible in both views: ``matched``: the object's most
frequent id is the same in both views. ``alone``: it is also no other object's most frequent id.
``iou``: IoU, in the second view, of the object with its most frequent id in the first. ``pieces``:
number of ids with at least 5 % of the object. ``pixels``: share of its pixels visible in both views
that have the same id in both. ``track``: CPU seconds of a pair without proposals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import SIZE, labelled, read_pairs
from slgaussian.benchmark.annotations import read_labels
from slgaussian.cameras.relative import Relative
from slgaussian.datasets import nerfstudio
from slgaussian.datasets.procedural import reader
from slgaussian.gaussians import source_depths
from slgaussian.geometry import SeenView
from slgaussian.masks import MaskTracker, Proposals, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.regions import Regions
from slgaussian.predict import load_predictor
from slgaussian.predict.pose_refinement import MAX_EPIPOLAR_DISTANCE, refine
from slgaussian.scene import Sample, View
from tests.matching import sift_matches

BASELINES = (0.3, 0.6, 0.9, 1.2, 1.6)
"""Metres; the cameras are about 3.3 m from the centre of the room."""
COPIES = (1, 3, 5, 7)
ARC = {2: (0, 7), 4: (0, 2, 5, 7), 8: tuple(range(8))}
"""Numbers of views, and which of eight views on an arc of 1.6 m are used."""
COMMON = 100
"""Smallest number of an object's pixels visible in both views."""
AGREE = 0.02
SENSOR_AGREE = 0.05
"""Largest relative depth difference of one point in two views, for true and sensor depth."""
LOST = 0.2
"""Share of the tiles that a noisy tracker drops in every call."""

SCORES = {
    "matched": ("matched", ".3f"),
    "alone": ("alone", ".3f"),
    "iou": ("IoU", ".3f"),
    "pieces": ("pieces", ".2f"),
    "pixels": ("pixels", ".3f"),
    "track": ("track, CPU s", ".2f"),
}


@dataclass
class Cell:
    """Samples that are averaged into one row: columns of objects, and seconds of pairs."""

    objects: list[dict[str, float]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def row(self) -> dict[str, float]:
        means = {
            key: float(np.mean([columns[key] for columns in self.objects]))
            for key in self.objects[0]
        }
        return {"objects": len(self.objects), **means, "track": float(np.mean(self.seconds))}


Cells = dict[str, Cell]


class CachedProposer:
    """A proposer that caches its proposals by image; ``seconds`` is its total time."""

    def __init__(self, propose: Callable[..., Proposals]) -> None:
        self.compute, self.cache, self.seconds = propose, {}, 0.0

    def propose(self, frame, region=None):
        key = frame.image.tobytes(), None if region is None else region.tobytes()
        if key not in self.cache:
            start = time.process_time()
            self.cache[key] = self.compute(frame, region)
            self.seconds += time.process_time() - start
        return self.cache[key]


def true_masks(views: tuple[View, ...]) -> Callable[..., Proposals]:
    """Return a proposer of the true masks: remaining errors are those of the tracker."""
    instances = {view.image.tobytes(): view.instances for view in views}

    def propose(frame, region=None):
        ids = instances[frame.image.tobytes()]
        masks = ids == np.unique(ids[ids > 0])[:, None, None]
        return Proposals(masks, np.ones(len(masks), np.float32))

    return propose


class Noisy:
    """A tracker with random errors in every call: each tile of 16 pixels may be dropped."""

    final = False

    def __init__(self, tracker: MaskTracker, share: float) -> None:
        self.tracker, self.share, self.rng = tracker, share, np.random.default_rng(0)
        self.add = tracker.add

    def propagate(self, frame):
        labels = self.tracker.propagate(frame)
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
    """Project the pixels of ``a`` into ``b``: row, column, and whether both show the point."""
    pixels, z = b.camera.project(a.camera.unproject(a.depth))
    column, row = np.floor(pixels).astype(int).transpose(2, 0, 1)
    inside = (z > 0) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    same = np.abs(b.depth[row, column] - z) < AGREE * z
    return row, column, inside & same & (b.instances[row, column] == a.instances)


def main_ids(labels: np.ndarray, truth: np.ndarray, objects: list[int]) -> list[int]:
    return [int(np.bincount(labels[truth == number]).argmax()) for number in objects]


def judge(a: View, b: View, labels: np.ndarray) -> list[dict[str, float]]:
    """Return the columns of each object visible in both views, for label maps [2, H, W]."""
    first, second = labels
    row, column, visible = landing(a, b)
    areas = np.bincount(a.instances[visible])
    objects = [i for i in np.flatnonzero(areas >= COMMON).tolist() if i]
    mains = [main_ids(first, a.instances, objects), main_ids(second, b.instances, objects)]
    rows = []
    for number, id_a, id_b in zip(objects, *mains, strict=True):
        labelled_area, true_area = second == id_a, b.instances == number
        shares = [
            np.bincount(m[t]) / t.sum()
            for m, t in ((first, a.instances == number), (second, true_area))
        ]
        matched = id_a == id_b > 0
        intersection = (labelled_area & true_area).sum()
        union = (labelled_area | true_area).sum()
        columns = {
            "matched": matched,
            "alone": matched and all(main.count(id_a) == 1 for main in mains),
            "iou": intersection / union if id_a else 0.0,
            "pieces": float(np.mean([(share[1:] >= 0.05).sum() for share in shares])),
            "pixels": (first == second[row, column])[visible].mean(),
        }
        rows.append(columns)
    return rows


def run(
    sample: Sample,
    depths: np.ndarray,
    proposer: CachedProposer,
    tracker: MaskTracker,
    replicas: int = 5,
) -> tuple[np.ndarray, float]:
    """Return label maps [2, H, W], and the seconds of tracking without proposals."""
    start, before = time.process_time(), proposer.seconds
    frames = list(map(SeenView, sample.context, depths))
    labels = associate(frames, proposer, tracker, replicas).labels
    return labels, time.process_time() - start - (proposer.seconds - before)


def pair_cells(pairs: int) -> tuple[Cells, Cells]:
    """Return cells by proposals and baseline, for all pairs, and by copies, for a fifth of them."""
    cells: Cells = {}
    copies: Cells = {}
    for seed in range(pairs):
        sample, baseline = read_pair(seed)
        depths = predicted_depths(sample)
        regions = CachedProposer(Regions().propose)
        truth = CachedProposer(true_masks(sample.context))

        def measure(proposer, tracker, *places, replicas=5, sample=sample, depths=depths):
            labels, seconds = run(sample, depths, proposer, tracker, replicas)
            for cell in places:
                cell.objects += judge(*sample.context, labels)
                cell.seconds.append(seconds)

        geometric = cells.setdefault("all", Cell())
        of_baseline = cells.setdefault(f"{baseline} m apart", Cell())
        measure(regions, load_tracker(), geometric, of_baseline)
        measure(truth, load_tracker(), cells.setdefault("all, true masks", Cell()))
        if seed < max(1, pairs // 5):
            for replicas in COPIES:
                for name in ("geometric", "noisy"):
                    tracker = load_tracker()
                    tracker = Noisy(tracker, LOST) if name == "noisy" else tracker
                    cell = copies.setdefault(f"{name}, {replicas}", Cell())
                    measure(regions, tracker, cell, replicas=replicas)
        print(f"pair {seed + 1} of {pairs}", flush=True)
    return cells, copies


def labelled_points(sample: Sample, labels: Path) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
    """Return, for each category, the pixels (rows, columns) of its points in both context views."""
    target = sample.targets[0]
    masks = read_labels(labels, Path(target.name).stem, SIZE[1], SIZE[0])
    grey = {v.name: cv2.cvtColor(v.image, cv2.COLOR_RGB2GRAY) for v in (target, *sample.context)}
    pixels = np.stack(np.meshgrid(np.arange(SIZE[1]) + 0.5, np.arange(SIZE[0]) + 0.5), -1)
    valid, places = target.depth > 0, []
    for view in sample.context:
        pose = Relative.between(target.camera, view.camera)
        a, b = sift_matches(grey[target.name], grey[view.name])
        close = np.abs(pose.epipolar_distance(a, b)) < MAX_EPIPOLAR_DISTANCE * np.hypot(*SIZE)
        relative = refine(pose, a[close], b[close])
        landed, ratio = relative.project(pixels, 1 / np.where(valid, target.depth, 1))
        column, row = np.floor(landed).astype(int).transpose(2, 0, 1)
        inside = (ratio > 0) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        z, sensor = target.depth * ratio, view.depth[row, column]
        valid = valid & inside & (sensor > 0) & (np.abs(z - sensor) < SENSOR_AGREE * z)
        places.append((row, column))
    masks = {name: mask & valid for name, mask in masks.items()}
    return {
        name: [(row[mask], column[mask]) for row, column in places]
        for name, mask in masks.items()
        if mask.sum() >= COMMON
    }


def photograph_cell(folder: Path) -> Cell:
    """Return the cell of labelled categories of photographs."""
    scene, cell = nerfstudio.read(folder), Cell()
    for context, target in read_pairs(folder / "pairs.json").values():
        sample = scene.sample(context, target, size=SIZE)
        proposer = CachedProposer(Regions().propose)
        labels, seconds = run(sample, predicted_depths(sample), proposer, load_tracker())
        cell.seconds.append(seconds)
        for a, b in labelled_points(sample, folder / "labels").values():
            ids_a, ids_b = labels[0][a], labels[1][b]
            mains = [np.bincount(ids).argmax() for ids in (ids_a, ids_b)]
            matched, pixels = mains[0] == mains[1] > 0, ((ids_a == ids_b) & (ids_a > 0)).mean()
            cell.objects.append({"matched": matched, "pixels": pixels})
    return cell


def object_ious(views: Sequence[View], labels: np.ndarray) -> list[float]:
    """Compute the IoU of each object with its most frequent id, over all views together."""
    truth = np.stack([view.instances for view in views])
    ious = []
    for number in np.unique(truth[truth > 0]):
        mask = truth == number
        ids = np.bincount(labels[mask])
        ids[0] = 0
        main = labels == ids.argmax()
        ious.append((mask & main).sum() / (mask | main).sum() if ids.any() else 0.0)
    return ious


def rows_of_views(rooms: int) -> list[dict]:
    """Return a row for each number of views, order and method: means over rooms."""
    means_of: dict[tuple, list[dict[str, float]]] = {}
    for seed in range(rooms):
        scene = reader.read(seed, height=SIZE[0], width=SIZE[1], views=8, baseline=1.6)
        arc = [scene.read(name) for name in scene.cameras]
        proposer = CachedProposer(Regions().propose)
        for count, places in ARC.items():
            views = [arc[k] for k in places]
            frames = [SeenView(view, view.depth) for view in views]
            shuffled = np.random.default_rng(seed).permutation(count)
            for name, order in (("arc", np.arange(count)), ("shuffled", shuffled)):
                labels = np.empty((count, *SIZE), np.int32)
                ordered = [frames[k] for k in order]
                labels[order] = associate(ordered, proposer, load_tracker()).labels
                judged = [
                    columns
                    for a, b in combinations(range(count), 2)
                    for columns in judge(views[a], views[b], labels[[a, b]])
                ]
                means = {
                    key: float(np.mean([columns[key] for columns in judged]))
                    for key in ("matched", "alone", "pixels")
                }
                means["iou"] = float(np.mean(object_ious(views, labels)))
                means_of.setdefault((count, name), []).append(means)
        print(f"room {seed + 1} of {rooms}", flush=True)
    return [
        dict(zip(("views", "order"), key, strict=True))
        | {name: float(np.mean([means[name] for means in rows])) for name in rows[0]}
        for key, rows in means_of.items()
    ]


def make_table(cells: Cells, title: str) -> str:
    rows = [{"name": name, **cell.row()} for name, cell in cells.items()]
    columns = {"name": (title, str), "objects": ("objects", "d")} | SCORES
    return table(rows, {key: columns[key] for key in columns if key in rows[0]})


def main() -> None:
    arguments = parser(__doc__, "masks.md")
    arguments.add_argument("data", type=labelled)
    arguments.add_argument("--pairs", type=int, default=50)
    arguments.add_argument("--rooms", type=int, default=3)
    args = arguments.parse_args()
    cells, copies = pair_cells(args.pairs)
    several = {"views": ("views", "d"), "order": ("order", str)}
    several |= {key: SCORES[key] for key in ("matched", "alone", "pixels", "iou")}
    publish(
        args.out,
        "masks.md",
        "python -m benches.masks.id_consistency DATA",
        make_table(cells, "made-up pairs"),
        make_table(copies, "tracker, copies"),
        make_table({"photographs": photograph_cell(args.data)}, "labelled categories"),
        table(rows_of_views(args.rooms), several),
    )


if __name__ == "__main__":
    main()
