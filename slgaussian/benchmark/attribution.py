"""Attribution of misses: stages are replaced by ground truth one after the other, from the last.

Replacements are cumulative; the first that turns the miss into a hit names the responsible stage.
`docs/reference/failures.md` describes the method and its limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import torch

from slgaussian.benchmark import metrics
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.answering import keep_understood
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.benchmark.scores import GOOD_IOU
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.geometry.seen import view_depths
from slgaussian.labels import MIN_WEIGHT
from slgaussian.language.answer import QueryResult, ask
from slgaussian.language.bank import MemoryBank
from slgaussian.language.objectmap import ObjectMap, central_point
from slgaussian.masks.flatten import nearest_pixel
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera, Sample, View
from slgaussian.semantic.votes import label_gaussians
from slgaussian.storage.specs import load_spec

REPLACEMENTS = {
    "iou": ("as it is", ""),
    "threshold_iou": ("threshold", "the best threshold for each query"),
    "language_iou": (
        "language",
        "the best objects, one for each connected part of the label",
    ),
    "masks_iou": ("masks", "labels of the target, projected into the context views"),
}
"""Title and description of the replaced stages by column of the spec ``attribution``, in order."""

STAGES = tuple(title for title, _ in REPLACEMENTS.values())[1:]

UNFIXABLE = "nothing mends it"
"""Cause if no replacement fixes the miss: the object is not in the photographs, its depth is wrong,
or the ground truth is inexact."""

MIN_COMPONENT_SHARE = 0.05
"""Fraction of a mask below which a connected component is ignored."""

OCCLUSION_TOLERANCE = 0.05
"""Relative depth difference from which on a point behind a surface is occluded."""

HOLE_WINDOW = 7
"""Side of the window, pixels, in which one known pixel fills holes of projected labels."""


def attribute_errors(
    field: SemanticField,
    gaussians: Gaussians,
    sample: Sample,
    truth: Truth,
    settings: EvaluationSettings | None = None,
) -> list[dict[str, Any]]:
    """Query a field with the labelled texts, and name the stage responsible for each miss.

    Args:
        field: A field of ``sample``.
        gaussians: Predicted Gaussians of the sample, before the field merged any.
        sample: True depths of its context views are used where known.
        truth: Queries with an empty mask are left out.
        settings: Columns of the rows, and rules for answers.

    Returns:
        A row per frame and query, with the columns of the data spec ``attribution``.
    """
    settings = settings or EvaluationSettings()
    rules = settings.rules
    common = {"dataset": settings.dataset, "scene": sample.scene, "method": settings.method}
    cameras = [view.camera for view in sample.context]
    depths = view_depths(gaussians, cameras)
    rows = []
    for target in sample.targets:
        masks = {q: mask for q, mask in truth.masks.get(target.name, {}).items() if mask.any()}
        if not masks:
            continue
        ids, opaque = field.render(target.camera).ids, target.opaque
        objects = ObjectMap(ids if opaque is None else np.where(opaque, ids, 0), field.bank.ids)
        labels, members = context_truth(sample, target, list(masks.values()), depths)
        labels = label_gaussians(gaussians, labels, cameras)[0]
        drawn = members[elect(gaussians, labels, target.camera)]
        drawn = drawn if opaque is None else drawn & opaque[..., None]
        known = keep_understood(field.reader, masks)
        answers = ask(known, objects, field.reader, rules) if known else []
        hits = dict(zip(known, answers, strict=True))
        for column, (query, mask) in enumerate(masks.items()):
            hit = hits.get(query)
            predicted, point = (np.zeros_like(mask), None) if hit is None else (hit.mask, hit.point)
            row: dict[str, Any] = common | {"frame": target.name, "query": query}
            row |= {"iou": metrics.iou(predicted, mask), "hit": metrics.point_in_mask(point, mask)}
            best_mask = objects.spread(best_objects(objects, field.bank, mask))
            judged = (
                _judge_threshold(hit, objects, mask),
                _judge(best_mask, mask),
                _judge(drawn[..., column], mask),
            )
            for stage, (iou, inside) in zip(STAGES, judged, strict=True):
                row |= {f"{stage}_iou": iou, f"{stage}_hit": inside}
            row["lost"] = verdict(row)
            rows.append({name: row[name] for name in load_spec("attribution").columns})
    return rows


def verdict(row: Mapping[str, Any]) -> str | None:
    """Return the stage responsible for the miss of a row of spec ``attribution``, None for hits."""
    if row["iou"] >= GOOD_IOU and row["hit"]:
        return None
    for stage in STAGES:
        if row[f"{stage}_iou"] >= GOOD_IOU and row[f"{stage}_hit"]:
            return stage
    return UNFIXABLE


def _judge(mask: np.ndarray, truth: np.ndarray) -> tuple[float, bool]:
    """Return the IoU of a mask, and whether its centre point is in the truth."""
    inside = bool(mask.any()) and metrics.point_in_mask(central_point(mask), truth)
    return metrics.iou(mask, truth), inside


def _judge_threshold(
    hit: QueryResult | None, objects: ObjectMap, truth: np.ndarray
) -> tuple[float, bool]:
    """Return the IoU with the best threshold, and whether its point or the best object's hits."""
    if hit is None or not hit.score:
        return 0.0, False
    total = int(np.count_nonzero(truth))
    chosen = best_prefix(hit.scores, objects.areas_within(truth), objects.areas, total)
    best = int(np.where(objects.areas > 0, hit.scores, -1).argmax())
    right = any(metrics.point_in_mask(point, truth) for point in (hit.point, objects.point(best)))
    return metrics.iou(objects.spread(chosen), truth), right


def best_prefix(
    scores: np.ndarray, inside: np.ndarray, areas: np.ndarray, total: int
) -> np.ndarray:
    """Choose a prefix of the objects, sorted by falling score, whose union has the best IoU.

    Args:
        scores: float [N]. Objects of equal score are chosen together.
        inside, areas: int [N]. Pixels of each object inside the mask, and in total.
        total: Pixels of the mask.

    Returns:
        bool [N]: The shortest of equally good prefixes; empty if no object overlaps the mask.
    """
    chosen = np.zeros(len(scores), bool)
    visible = np.flatnonzero(areas > 0)
    order = visible[np.argsort(-scores[visible], kind="stable")]
    hits, sizes = np.cumsum(inside[order]), np.cumsum(areas[order])
    ious = hits / np.maximum(total + sizes - hits, 1)
    ious[:-1][scores[order][1:] == scores[order][:-1]] = 0
    if ious.max(initial=0) > 0:
        chosen[order[: int(ious.argmax()) + 1]] = True
    return chosen


def best_objects(objects: ObjectMap, bank: MemoryBank, truth: np.ndarray) -> np.ndarray:
    """Choose the objects that perfect language features would select in an image: bool [N].

    Objects or groups of the bank are chosen greedily by IoU, as many as the truth bool [H, W] has
    connected components above the fraction :data:`MIN_COMPONENT_SHARE`.
    """
    inside, total, count = objects.areas_within(truth), np.count_nonzero(truth), len(bank)
    members = np.eye(count, dtype=bool)
    if bank.levels is not None and bank.group_features is not None:
        groups = np.arange(count, count + len(bank.group_features))
        members = np.concatenate([members, (bank.levels == groups[:, None, None]).any(1)])
    stats = cv2.connectedComponentsWithStats(truth.astype(np.uint8), connectivity=8)[2]
    parts = int(np.count_nonzero(stats[1:, cv2.CC_STAT_AREA] >= MIN_COMPONENT_SHARE * total))
    chosen, best = np.zeros(count, bool), 0.0
    for _ in range(parts):
        tried = members | chosen
        ious = tried @ inside / (total + tried @ (objects.areas - inside))
        if ious.max(initial=0) <= best:
            break
        best, chosen = ious.max(), tried[ious.argmax()]
    return chosen


def elect(gaussians: Gaussians, labels: np.ndarray, camera: Camera) -> np.ndarray:
    """Render labels int32 [N] of Gaussians, 0 for none: int32 [H, W], 0 where none is visible."""
    ids = np.unique(labels[labels > 0])
    members = torch.from_numpy((labels[:, None] == ids).astype(np.float32))
    weights = rasterize(gaussians, members, camera).values.numpy()
    best = np.pad(weights, ((0, 0), (0, 0), (0, 1))).argmax(-1)  # 0 without any label
    return np.where(weights.sum(-1) >= MIN_WEIGHT, np.append(ids, 0)[best], 0).astype(np.int32)


def context_truth(
    sample: Sample, target: View, masks: Sequence[np.ndarray], predicted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Project masks bool [H, W] of a target, one per query, into the context views.

    Depths of context pixels are the true ones, or ``predicted`` float [V, H, W] where unknown.

    Returns:
        int32 [V, H, W] and bool [L + 1, Q]: the label of each pixel, 0 if it is occluded in the
        target, and whether query q belongs to label l; label 1 belongs to none.
    """
    sets = np.zeros(masks[0].shape, np.int64)
    for mask in masks:
        sets = 2 * sets + mask
        used = np.flatnonzero(np.bincount(sets.ravel()))
        sets = np.searchsorted(used, sets)
    sets += 2
    members = np.zeros((int(sets.max()) + 1, len(masks)), bool)
    for column, mask in enumerate(masks):
        members[np.unique(sets[mask]), column] = True
    nothing = np.zeros(sample.context[0].image.shape[:2], np.float32)
    true = np.stack([nothing if v.depth is None else v.depth for v in sample.context])
    place = carried_back(sample, target, np.where(true > 0, true, predicted))
    for pixels in place:
        # A small depth error occludes single pixels of a surface.
        is_known = pixels >= 0
        if is_known.any():
            near = (
                cv2.dilate(is_known.astype(np.uint8), np.ones((HOLE_WINDOW, HOLE_WINDOW), np.uint8))
                > 0
            )
            pixels[:] = np.where(near, pixels[nearest_pixel(is_known)], -1)
    return np.where(place >= 0, sets.ravel()[place], 1).astype(np.int32), members


def carried_back(sample: Sample, target: View, depths: np.ndarray) -> np.ndarray:
    """Return the flat index int64 [V, H, W] of the target pixel that shows a context pixel, or -1.

    ``depths`` float [V, H, W] are z-depths of the context views, 0 unknown. Occlusion in the target
    is tested with its true depth, or with these where it is unknown.
    """
    height, width = target.image.shape[:2]
    nearest = np.full(height * width, np.inf)
    landed = []
    for view, depth in zip(sample.context, depths, strict=True):
        pixels, z = target.camera.project(view.camera.unproject(depth))
        inside = (depth > 0) & target.camera.shows(pixels, z)
        column, row = np.where(inside[..., None], pixels, 0).astype(np.int64).transpose(2, 0, 1)
        place = np.where(inside, row * width + column, -1)
        np.minimum.at(nearest, place[inside], z[inside])
        landed.append((place, z))
    # Forward-projected pixels leave holes if the target view is closer or has higher resolution.
    side = 1 + 2 * max(1, math.ceil(height / sample.context[0].image.shape[0]))
    square = np.ones((side, side), np.uint8)
    front = cv2.erode(nearest.reshape(height, width), square, borderType=cv2.BORDER_REPLICATE)
    if target.depth is not None:
        front = np.where(target.depth > 0, target.depth, front)
    limit = (1 + OCCLUSION_TOLERANCE) * front.ravel()
    return np.stack([np.where(z <= limit[place], place, -1) for place, z in landed])
