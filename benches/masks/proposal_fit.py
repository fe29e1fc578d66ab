"""Does one weight-free mask fit one object? Rows for ``mask_quality.py``.

Procedural views have exact truth; of photographs, labelled categories of the target views of
``pairs.json`` (LERF-OVS JSON in ``labels/``) are looked for. ``one`` and ``three`` are the mean IoU
of a true object or category with its best region of the flat map and with its best union of three;
``any`` is that with the best mask of all levels. What becomes of them in two views is
``id_consistency.py``.
"""

import time
from pathlib import Path

import numpy as np

from benches.common.photograph_pairs import SIZE, read_pairs
from slgaussian.benchmark.annotations import read_labels
from slgaussian.datasets import nerfstudio
from slgaussian.datasets.procedural import reader
from slgaussian.gaussians import source_depths
from slgaussian.geometry import SeenView
from slgaussian.masks.flatten import flatten
from slgaussian.masks.regions import Regions
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.scene import Sample, View

VIEWS = 8
LABELLED_SIZE = (360, 540)
LEAST = 100
"""Fewest pixels of an object that counts."""
STUFF = {
    *("blue carpet", "wooden floor", "grey wall", "red wall", "black countertop", "curtain"),
    *("black door", "white door", "wooden door frame", "window"),
}
"""Labelled categories without a shape of their own, or set into a wall; the others are things."""


def best_unions(labels: np.ndarray, truth: np.ndarray, most: int = 3) -> tuple[float, float]:
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


def best_mask(masks: np.ndarray, truth: np.ndarray) -> float:
    """IoU of ``truth`` with the best one of ``masks``."""
    shared = (masks & truth).sum((1, 2))
    return (shared / (masks.sum((1, 2)) + truth.sum() - shared)).max()


def fit(
    image: np.ndarray, depth: np.ndarray | None, truths: dict[str, np.ndarray]
) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """How well each true mask is met, by its name; and numbers of masks and seconds."""
    start = time.process_time()
    found = Regions(level="all").propose(SeenView.alone(image, depth))
    seconds = time.process_time() - start
    labels = flatten(Regions().propose(SeenView.alone(image, depth)))
    met = {}
    for name, truth in truths.items():
        one, three = best_unions(labels, truth)
        met[name] = {"one": one, "three": three, "any": best_mask(found.masks, truth)}
    return met, {"regions": labels.max(), "masks": len(found.masks), "seconds": seconds}


def summary(met: list[dict[str, float]], costs: list[dict[str, float]]) -> dict[str, float]:
    """One row: means, and the most masks of an image."""
    row = {key: float(np.mean([m[key] for m in met])) for key in met[0]}
    row |= {key: float(np.mean([c[key] for c in costs])) for key in ("regions", "seconds")}
    return {"objects": len(met), **row, "masks": max(c["masks"] for c in costs)}


def procedural_rows() -> list[dict]:
    rows = []
    for kind in ("none", "true"):
        met, costs = [], []
        for seed in range(VIEWS):
            scene = reader.read(seed=seed, height=SIZE[0], width=SIZE[1])
            view = scene.read(list(scene.cameras)[-1])
            truths = {i: view.instances == i for i in np.unique(view.instances) if i}
            truths = {i: truth for i, truth in truths.items() if truth.sum() >= LEAST}
            one, cost = fit(view.image, view.depth if kind == "true" else None, truths)
            met += one.values()
            costs.append(cost)
        what = f"{VIEWS} views of made-up rooms"
        rows.append({"what": what, "depth": kind, **summary(met, costs)})
    return rows


def labelled_rows(folder: Path) -> tuple[list[dict], list[dict]]:
    """Rows by kind of category and of depth; and one row for each category of each scene."""
    dataset = nerfstudio.read(folder)
    height, width = LABELLED_SIZE
    met, costs, each = {}, {}, []
    for scene, (context, target) in read_pairs(folder / "pairs.json").items():
        view, other = (
            dataset.read(dataset.find(n)).resized(height, width) for n in (target[0], context[0])
        )
        truths = read_labels(folder / "labels", Path(target[0]).stem, width, height)
        truths = {name: mask for name, mask in truths.items() if mask.sum() >= LEAST}
        depths = {"none": None, "ours": predicted_depth(view, other), "sensor": view.depth}
        by_kind = {}
        for kind, depth in depths.items():
            by_kind[kind], cost = fit(view.image, depth, truths)
            costs.setdefault(kind, []).append(cost)
            for name, values in by_kind[kind].items():
                which = "stuff" if name in STUFF else "things"
                met.setdefault((kind, "all"), []).append(values)
                met.setdefault((kind, which), []).append(values)
        for name in truths:
            row = {"scene": scene, "category": name, "stuff": "stuff" if name in STUFF else "thing"}
            row |= {kind: by_kind[kind][name]["any"] for kind in by_kind}
            each.append({**row, "one": by_kind["ours"][name]["one"]})
    rows = [
        {"what": f"photographs, {which}", "depth": kind, **summary(met[kind, which], costs[kind])}
        for which in ("all", "things", "stuff")
        for kind in ("none", "ours", "sensor")
    ]
    return rows, sorted(each, key=lambda row: row["ours"])


def predicted_depth(view: View, other: View) -> np.ndarray:
    """Depth of ``view`` as the plane sweep sees it from the two photographs."""
    gaussians = PlaneSweep()(Sample(view.name, (view, other)))
    return source_depths(gaussians, [view.camera, other.camera])[0]
