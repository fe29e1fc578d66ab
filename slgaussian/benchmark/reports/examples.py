"""Parts of a report with pictures: an example scene, single answers, and all views of a scene."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from slgaussian.benchmark import pictures
from slgaussian.benchmark.evaluate import RENDERED_VIEWPOINTS
from slgaussian.benchmark.reports.model import Block, Card, Fold, Gallery, Picture, Section
from slgaussian.benchmark.scores import GOOD_IOU, Rows, group_rows

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]
Key = tuple[str, str, str]

MAX_CAPTIONS = 10
"""Largest number of captions in one picture."""

CAPTIONED_WIDTH, FONT_SIZE = 960, 24
"""Width of a picture with captions, and their font size, pixels."""

SLIDER_WIDTH, ANSWER_WIDTH, SCENE_WIDTH = 800, 480, 360
"""Widths of pictures of the slider, of answers, and in the section of a scene, pixels."""

POOR_IOU = 0.25
"""Smallest IoU of an answer that is not marked as poor."""

VIEW_PICTURES = {
    "input": "context view",
    "labels": "objects",
    "depth": "depth, red near, blue far",
    "true_depth": "true depth",
    "photo": "held-out view",
    "render": "rendered",
    "ids": "objects, rendered",
}
"""Captions of the pictures of a view, by kind of picture."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a report; pictures and masks are read on demand, one scene at a time.

    ``metrics``, ``pictures`` and ``masks`` (by protocol, frame and query) are of our result,
    ``truth`` are labelled masks.
    """

    name: str
    dataset: str
    metrics: Mapping[str, float]
    pictures: Callable[[], Images]
    truth: Callable[[], Mapping[str, Images]]
    masks: Callable[[], Mapping[Key, np.ndarray]]


def choose_example(scenes: Sequence[Scene]) -> Scene:
    """Return a typical scene, that of median IoU; without IoU the first scene."""
    scored = [scene for scene in scenes if "iou" in scene.metrics]
    scored.sort(key=lambda scene: (scene.metrics["iou"], scene.name))
    return scored[(len(scored) - 1) // 2] if scored else scenes[0]


def answer_card(row: Row, images: Images, lost_by: str = "") -> Card:
    """Return an answer as a card; ``lost_by`` is the stage responsible for a miss."""
    query, chips = row["query"], []
    if row["iou"] is not None:
        grade = "good" if row["iou"] >= GOOD_IOU else "fair" if row["iou"] >= POOR_IOU else "poor"
        point = {None: "–", True: "✓", False: "✗"}[row["hit_mask"]]
        chips = [(f"IoU {row['iou']:.2f}", grade), (f"point {point}", "")]
    elif row["score"] is not None:
        chips = [(f"relevancy {row['score']:.2f}", "")]
    if lost_by:
        chips.append((f"lost by {lost_by}", "lost"))
    name = f"{row['frame']}/{query}"
    panels = [
        Picture.encode(images[f"{kind}/{name}"], ANSWER_WIDTH, caption, f"{caption} of {query}")
        for kind, caption in (("mask", "prediction"), ("relevancy", "relevancy"))
    ]
    place = f"{row['scene']}, {row['frame']}"
    return Card(query, chips, panels, f"{place}: {row['note']}" if row["note"] else place)


def example_section(scene: Scene, rows: Sequence[Row], images: Images) -> Section:
    """Return the section of an example scene: all answers in one view, and a slider.

    ``rows`` are those of our method in the first protocol.
    """
    inputs = {name: images[f"input/{name}"] for name in _frames(images, "input")}
    blocks: list[Block] = []
    small = {f"context view {name}": image for name, image in inputs.items()}
    drawn = [row for row in rows if f"mask/{row['frame']}/{row['query']}" in images]
    scored = [row for row in drawn if row["iou"] is not None]
    # The frame with most scored answers, else most answers.
    if answers := max(group_rows(scored or drawn, "frame").values(), key=len, default=[]):
        frame, is_scored = answers[0]["frame"], answers[0]["iou"] is not None
        ground = images.get(f"photo/{frame}", images[f"render/{frame}"])
        masks, truth = scene.masks(), scene.truth().get(frame, {})
        named = {row["query"]: row for row in answers[:MAX_CAPTIONS]}
        captions = {q: f"{q} {row['iou']:.2f}" if is_scored else q for q, row in named.items()}
        predicted = {q: masks.get((row["protocol"], frame, q)) for q, row in named.items()}
        caption = f"predicted masks in {frame}" + ", with IoU" * is_scored
        picture = _draw_masks(ground, captions, predicted)
        blocks.append(Gallery([Picture.encode(picture, CAPTIONED_WIDTH, caption)], "main"))
        small |= {f"rendered {frame}": images[f"render/{frame}"]}
        if any(truth[query].any() for query in named if query in truth):
            small["ground truth"] = _draw_masks(ground, {query: query for query in named}, truth)
    if len(inputs) > 1:
        (start, start_image), (end, end_image) = list(inputs.items())[:2]
        steps = {f"context view {start}": start_image}
        steps |= {f"rendered, {way}": images[f"render/{way}"] for way in RENDERED_VIEWPOINTS}
        steps[f"context view {end}"] = end_image
        blocks.append(_gallery(steps, SLIDER_WIDTH, "walk"))
    blocks.append(_gallery(small, ANSWER_WIDTH, "strip-of"))
    return Section("Example", blocks, "example", scene.name, style="example")


def scene_fold(scene: Scene, id: str, images: Images) -> Fold:
    """Return the collapsed pictures of all views of a scene."""
    rows = [
        {
            f"{title} {name}": images[f"{kind}/{name}"]
            for kind, title in VIEW_PICTURES.items()
            if f"{kind}/{name}" in images
        }
        for name in (*_frames(images, "input"), *_frames(images, "photo"), *RENDERED_VIEWPOINTS)
    ]
    return Fold(scene.name, [_gallery(row, SCENE_WIDTH, "grid tiles") for row in rows], id)


def _gallery(images: Images, width: int, layout: str) -> Gallery:
    """Return pictures by caption side by side."""
    return Gallery([Picture.encode(image, width, name) for name, image in images.items()], layout)


def _frames(images: Images, kind: str) -> list[str]:
    return [name.split("/", 1)[1] for name in images if name.startswith(f"{kind}/")]


def _draw_masks(
    image: np.ndarray, captions: Mapping[str, str], masks: Mapping[str, np.ndarray | None]
) -> np.ndarray:
    """Return the enlarged view with the coloured and captioned mask of each query."""
    size = CAPTIONED_WIDTH, round(image.shape[0] * CAPTIONED_WIDTH / image.shape[1])
    large = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
    regions = [
        pictures.Region(caption, cv2.resize(mask.astype(np.float32), size) > 0.5, place)
        for place, (query, caption) in enumerate(captions.items(), 1)
        if (mask := masks.get(query)) is not None
    ]
    return pictures.draw_regions(large, regions, FONT_SIZE)


def worst_answers(rows: Rows, count: int, per_scene: int) -> list[Row]:
    """Return the scored rows of lowest IoU, wrong points first, at most a few per scene.

    A query occurs once per scene. Without scores any rows are returned.
    """
    rows = rows.having("iou") or rows
    badness = [(row["iou"] or 0, bool(row["hit_mask"]), bool(row["hit_box"])) for row in rows]
    worst: list[Row] = []
    queries: dict[str, set[str]] = defaultdict(set)
    for place in sorted(range(len(rows)), key=badness.__getitem__):
        row = rows[place]
        scene_queries = queries[row["scene"]]
        if len(scene_queries) < per_scene and row["query"] not in scene_queries:
            scene_queries.add(row["query"])
            worst.append(row)
            if len(worst) == count:
                break
    return worst
