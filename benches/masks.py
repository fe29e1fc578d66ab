"""How good and how fast masks without weights are: run ``python benches/masks.py [DATA]``.

Procedural pairs have exact truth. DATA, where given, is a folder with the camera file
``transforms.json``, ``pairs.json`` (scene -> context and target views) and LERF-OVS labels in
``labels/``; regions are then also compared with the labelled categories of the target views.

Columns: ``one`` and ``three`` are the mean IoU of a true object (or category) with its best region
and with its best union of three regions; ``any`` with the best mask of all levels. What becomes of
them in two views is ``benches/association.py``.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from slgaussian.benchmark.labels import read_labels
from slgaussian.datasets import nerfstudio, procedural
from slgaussian.gaussians import source_depths
from slgaussian.masks.flatten import flatten
from slgaussian.masks.regions import Regions
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.scene import Sample

SIZE = (416, 576)
LABELLED_SIZE = (360, 540)
STUFF = {
    *("blue carpet", "wooden floor", "grey wall", "red wall", "black countertop", "curtain"),
    *("black door", "white door", "wooden door frame", "window"),
}
"""Labelled categories without a shape of their own, or set into a wall; the others are things."""


def best_unions(labels, truth, most=3):
    """IoU of ``truth`` with the greedily best union of 1 .. ``most`` regions."""
    inter = np.bincount(labels[truth], minlength=labels.max() + 1).astype(float)
    area = np.bincount(labels.ravel(), minlength=len(inter))
    shared, joined, out = 0.0, float(truth.sum()), []
    for _ in range(most):
        iou = (shared + inter) / (joined + area - inter)
        pick = int(iou.argmax())
        if out and iou[pick] <= out[-1]:
            break
        out.append(iou[pick])
        shared, joined = shared + inter[pick], joined + area[pick] - inter[pick]
        inter[pick], area[pick] = 0, 0
    return out[0], out[-1]


def best_mask(masks, truth):
    """IoU of ``truth`` with the best one of ``masks``."""
    shared = (masks & truth).sum((1, 2))
    return (shared / (masks.sum((1, 2)) + truth.sum() - shared)).max()


def procedural_rows(seeds=8):
    for use_depth in (False, True):
        rows = []
        for seed in range(seeds):
            scene = procedural.read(seed=seed, height=SIZE[0], width=SIZE[1])
            view = scene.read(list(scene.cameras)[-1])
            start = time.process_time()
            proposals = Regions().propose(view.image, depth=view.depth if use_depth else None)
            seconds = time.process_time() - start
            labels = flatten(proposals)
            truths = [view.instances == i for i in np.unique(view.instances) if i]
            ious = [best_unions(labels, t) for t in truths if t.sum() >= 100]
            rows.append([*np.mean(ious, 0), labels.max(), seconds])
        one, three, count, seconds = np.mean(rows, 0)
        print(
            f"procedural, {'true' if use_depth else 'no'} depth, {seeds} views:",
            f"one {one:.3f} three {three:.3f} objects {count:.0f} CPU s {seconds:.2f}",
        )


def labelled_rows(folder):
    scene = nerfstudio.read(folder)
    pairs = json.loads((folder / "pairs.json").read_text())
    views, truths = [], []
    for pair in pairs.values():
        names = pair["target"][0], pair["context"][0]
        views.append([scene.read(scene.find(name)).resized(*LABELLED_SIZE) for name in names])
        height, width = LABELLED_SIZE
        found = read_labels(folder / "labels", Path(names[0]).stem, width, height)
        truths.append({name: mask for name, mask in found.items() if mask.sum() >= 100})
    depths = {
        "no": [None] * len(views),
        "sensor": [target.depth for target, _ in views],
        "predicted": [predicted_depth(*pair) for pair in views],
    }
    Regions(level="all").propose(views[0][0].image)  # compile
    for kind, maps in depths.items():
        rows, stuff, counts, seconds = [], [], [], []
        for (view, _), truth, depth in zip(views, truths, maps, strict=True):
            start = time.process_time()
            found = Regions(level="all").propose(view.image, depth=depth)
            seconds.append(time.process_time() - start)
            objects = flatten(Regions().propose(view.image, depth=depth))
            counts.append([objects.max(), len(found.masks)])
            for name, mask in truth.items():
                rows.append([*best_unions(objects, mask), best_mask(found.masks, mask)])
                stuff.append(name in STUFF)
        rows, stuff = np.array(rows), np.array(stuff)
        for name, use in (("all", stuff | True), ("things", ~stuff), ("stuff", stuff)):
            one, three, best = rows[use].mean(0)
            print(
                f"labelled, {kind} depth, {use.sum()} {name}:",
                f"one {one:.3f} three {three:.3f} any {best:.3f}",
            )
        print(
            f"  objects {np.mean(counts, 0)[0]:.0f}, masks {np.mean(counts, 0)[1]:.0f}, at most",
            f"{np.max(counts, 0)[1]}; CPU s {np.mean(seconds):.2f}, at most {max(seconds):.2f}",
        )


def predicted_depth(view, other):
    """Depth of ``view`` as the plane sweep sees it from the two photographs."""
    gaussians = PlaneSweep()(Sample(view.name, (view, other)))
    return source_depths(gaussians, [view.camera, other.camera])[0]


def step_rows():
    scene = procedural.read(seed=0, height=SIZE[0], width=SIZE[1])
    image = scene.read("view_00").image
    steps = {
        "propose": lambda: Regions().propose(image),
        "propose all levels": lambda: Regions(level="all").propose(image),
    }
    for name, step in steps.items():
        start = time.process_time()
        step()
        print(f"{name}: {time.process_time() - start:.2f} CPU s")


if __name__ == "__main__":
    procedural_rows()
    if len(sys.argv) > 1:
        labelled_rows(Path(sys.argv[1]))
    step_rows()
