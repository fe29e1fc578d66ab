"""How good and how fast the default mask stage is: run ``python benches/masks.py [DATA]``.

Procedural pairs have exact truth. DATA, where given, is a folder with the camera file
``transforms.json``, ``pairs.json`` (scene -> context and target views) and LERF-OVS labels in
``labels/``; regions are then also compared with the labelled categories of the target views.

Columns: ``one`` and ``three`` are the mean IoU of a true object (or category) with its best region
and with its best union of three regions; ``tree`` with the best node of the merge tree; ``same`` is
the share of pixels seen by both views whose ids agree; ``matched`` the share of objects, walls
aside, whose main id is the same in both views.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from slgaussian.benchmark.labels import read_labels
from slgaussian.datasets import nerfstudio, procedural
from slgaussian.masks.associate import associate
from slgaussian.masks.flatten import flatten
from slgaussian.masks.flow import FlowTracker
from slgaussian.masks.regions import Regions, grow_tree

SIZE = (416, 576)


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


def best_node(tree, truth):
    """IoU of ``truth`` with the best node of a merge tree."""
    count = tree.leaves.max() + 1
    inter, area = np.zeros((2, len(tree.parent)))
    inter[:count] = np.bincount(tree.leaves[truth], minlength=count)
    area[:count] = np.bincount(tree.leaves.ravel(), minlength=count)
    for node, parent in enumerate(tree.parent):
        if parent >= 0:
            inter[parent] += inter[node]
            area[parent] += area[node]
    return (inter / (area + truth.sum() - inter)).max()


def same_ids(a, b, labels):
    """Share of the pixels of ``a`` that ``b`` sees too and that carry one id in both views."""
    pixels, z = b.camera.project(a.camera.unproject(a.depth))
    column, row = np.floor(pixels).astype(int).transpose(2, 0, 1)
    inside = (z > 0) & (column >= 0) & (column < SIZE[1]) & (row >= 0) & (row < SIZE[0])
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    seen = inside & (np.abs(b.depth[row, column] - z) < 0.02 * z)
    return (labels[0] == labels[1][row, column])[seen].mean()


def matched(a, b, labels, phrases):
    """Share of objects, seen with 100 pixels in both views, whose main id is the same."""
    hits = []
    for instance in np.intersect1d(a.instances, b.instances):
        masks = a.instances == instance, b.instances == instance
        if instance and min(m.sum() for m in masks) >= 100 and "wall" not in phrases[instance]:
            main = [np.bincount(labels[v][mask]).argmax() for v, mask in enumerate(masks)]
            hits.append(main[0] == main[1])
    return np.mean(hits)


def procedural_rows(seeds=8):
    for use_depth in (False, True):
        rows = []
        for seed in range(seeds):
            scene = procedural.read(seed=seed, height=SIZE[0], width=SIZE[1])
            names = list(scene.cameras)
            a, b = scene.read(names[0]), scene.read(names[-1])
            depths = [a.depth, b.depth] if use_depth else None
            start = time.process_time()
            maps = associate([a, b], Regions(), FlowTracker(), depths=depths)
            seconds = time.process_time() - start
            truths = [b.instances == i for i in np.unique(b.instances) if i]
            ious = [best_unions(maps.labels[1], t) for t in truths if t.sum() >= 100]
            same = same_ids(a, b, maps.labels)
            right = matched(a, b, maps.labels, scene.phrases)
            rows.append([*np.mean(ious, 0), same, right, len(maps.ids), seconds])
        print(f"procedural, {'true' if use_depth else 'no'} depth, {seeds} pairs:", *_named(rows))


def _named(rows):
    names = ("one", "three", "same", "matched", "ids", "CPU s")
    return [f"{n} {v:.3f}" for n, v in zip(names, np.mean(rows, 0), strict=True)]


def labelled_rows(folder):
    scene = nerfstudio.read(folder)
    pairs = json.loads((folder / "pairs.json").read_text())
    for use_depth in (False, True):
        rows, counts = [], []
        for pair in pairs.values():
            name = pair["target"][0]
            view = scene.read(scene.find(name)).resized(*SIZE)
            truths = read_labels(folder / "labels", Path(name).stem, SIZE[1], SIZE[0])
            depth = view.depth if use_depth else None
            tree = grow_tree(view.image, depth=depth)
            labels = flatten(Regions().propose(view.image, depth=depth))
            counts.append(labels.max())
            for truth in truths.values():
                if truth.sum() >= 100:
                    rows.append([*best_unions(labels, truth), best_node(tree, truth)])
        one, three, node = np.mean(rows, 0)
        print(
            f"labelled, {'sensor' if use_depth else 'no'} depth, {len(rows)} categories:",
            f"one {one:.3f} three {three:.3f} tree {node:.3f} regions {np.mean(counts):.0f}",
        )


def step_rows():
    scene = procedural.read(seed=0, height=SIZE[0], width=SIZE[1])
    names = list(scene.cameras)
    a, b = scene.read(names[0]), scene.read(names[-1])
    tracker = FlowTracker()
    labels = flatten(Regions().propose(a.image))
    steps = {
        "propose": lambda: Regions().propose(a.image),
        "remember": lambda: tracker.add(a, labels),
        "propagate": lambda: tracker.propagate(b),
        "replica": lambda: tracker.propagate(a),
        "pair": lambda: associate([a, b], Regions(), FlowTracker()),
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
