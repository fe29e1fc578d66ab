"""Sections with pictures: example scenes, answers, and all scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from slgaussian.benchmark import pictures
from slgaussian.benchmark.evaluate import ALONG_THE_WAY, ERROR_TOP
from slgaussian.benchmark.reports.model import (
    Block,
    Card,
    Cards,
    Cell,
    Column,
    Fold,
    Gallery,
    Picture,
    Prose,
    Section,
    Table,
    Terms,
    count_text,
    number,
)
from slgaussian.benchmark.scores import GOOD, grouped, key_of

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]
Key = tuple[str, str, str]

NAMED_OBJECTS = 10
"""Largest number of captions in one picture."""

LARGE, FONT_SIZE = 960, 24
"""Width of a picture with captions, and their font size, pixels."""

SLIDER, ANSWER, SMALL = 800, 480, 360
"""Widths of pictures of the slider, of answers, and in the section of a scene, pixels."""

WORST, PER_SCENE = 8, 2
"""Number of answers with the lowest scores shown for a run, and their usual maximum per scene."""

ANSWERS = 4
"""Number of answers shown for a scene."""

FAIR = 0.25
"""Smallest IoU of an answer that is not marked as poor."""

VIEW_PICTURES = {
    "input": "context view",
    "labels": "objects",
    "depth": "depth",
    "true_depth": "true depth",
    "depth_error": "depth error",
    "photo": "held-out view",
    "render": "rendered",
    "ids": "objects, rendered",
}
"""Captions of the pictures of a view, by kind of picture."""

ANSWER_TERMS = Terms(
    {
        "prediction": "predicted mask, in colour and outlined; the rest is dimmed",
        "ground truth": "outline of the labelled mask",
        "point": "predicted point; ✓ inside the labelled mask, ✗ outside",
        "relevancy": "of the query, stretched to its range in the picture, 0 to 1",
    },
    {
        "prediction": "swatch predicted",
        "ground truth": "swatch true",
        "point": "dot",
        "relevancy": "bar relevancy",
    },
)


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a report; pictures and masks are read on demand, one scene at a time.

    ``rows`` are of the spec ``samples``, our method first; ``metrics``, ``pictures`` (uint8
    [H, W, 3] by name) and ``masks`` (bool [H, W] by protocol, frame and query) are of our result,
    and ``truth`` has the labelled masks by frame and query.
    """

    name: str
    dataset: str
    rows: Sequence[Row]
    metrics: Mapping[str, float]
    pictures: Callable[[], Images]
    truth: Callable[[], Mapping[str, Images]]
    masks: Callable[[], Mapping[Key, np.ndarray]]


def choose_example(scenes: Sequence[Scene]) -> tuple[Scene, str]:
    """Return a typical scene, that of median IoU, and the reason; without IoU the first scene."""
    scored = sorted(
        (scene for scene in scenes if "iou" in scene.metrics),
        key=lambda scene: (scene.metrics["iou"], scene.name),
    )
    scene = scored[(len(scored) - 1) // 2] if scored else scenes[0]
    reason = f"{'median IoU' if scored else 'first'} of {len(scenes)} scenes"
    return scene, reason if scenes[1:] else ""


def sort_worst_first(rows: Iterable[Row]) -> list[Row]:
    """Sort the scored rows by IoU; for equal IoU, rows with a wrong point come first."""
    scored = [row for row in rows if row["iou"] is not None]
    return sorted(scored, key=lambda row: (row["iou"], bool(row["hit_mask"]), bool(row["hit_box"])))


def limit_per_scene(rows: Sequence[Row], count: int) -> list[Row]:
    """Return the first ``count`` rows, at most :data:`PER_SCENE` per scene if there are enough.

    A query that was asked in several frames of a scene occurs once.
    """
    limit = max(PER_SCENE, -(-count // (len({row["scene"] for row in rows}) or 1)))
    by_query: dict[tuple[str, str], Row] = {}
    for row in rows:
        by_query.setdefault((row["scene"], row["query"]), row)
    counts: Counter[str] = Counter()
    chosen = []
    for row in by_query.values():
        if counts[row["scene"]] < limit:
            counts[row["scene"]] += 1
            chosen.append(row)
    return chosen[:count]


def answer_card(row: Row, images: Images, lost_by: str = "", is_placed: bool = True) -> Card:
    """Return an answer as a card; with ``is_placed`` its note contains scene and frame.

    ``lost_by`` is the stage responsible for a miss.
    """
    query, chips = row["query"], []
    if row["iou"] is not None:
        grade = "good" if row["iou"] >= GOOD else "fair" if row["iou"] >= FAIR else "poor"
        point = {None: "–", True: "✓", False: "✗"}[row["hit_mask"]]
        chips = [(f"IoU {row['iou']:.2f}", grade), (f"point {point}", "")]
    elif row["score"] is not None:
        chips = [(f"relevancy {row['score']:.2f}", "")]
    if lost_by:
        chips.append((f"lost by {lost_by}", "lost"))
    name = f"{row['frame']}/{query}"
    panels = [
        Picture.of(images[f"mask/{name}"], ANSWER, "prediction", f"predicted mask of {query}"),
        Picture.of(images[f"relevancy/{name}"], ANSWER, "relevancy", f"relevancy of {query}"),
    ]
    note = [f"{row['scene']}, {row['frame']}"] * is_placed + [row["note"]] * bool(row["note"])
    return Card(query, chips, panels, ": ".join(note))


def example_section(
    scene: Scene, reason: str, rows: Sequence[Row], images: Images, lost_by: Mapping[Key, str]
) -> Section:
    """Return the section of an example scene: all answers in one view, a slider, and some answers.

    ``rows`` are those of our method in the first protocol.
    """
    answers = _rows_of_best_frame(rows, images)
    frame = answers[0]["frame"] if answers else next(iter(_frames(images, "photo")), "")
    inputs = {name: images[f"input/{name}"] for name in _frames(images, "input")}
    blocks: list[Block] = []
    small = {f"context view {name}": image for name, image in inputs.items()}
    if f"photo/{frame}" in images:
        small[f"held-out view {frame}, photograph"] = images[f"photo/{frame}"]
        small[f"held-out view {frame}, rendered"] = images[f"render/{frame}"]
    cards: list[Block] = []
    if answers:
        ground = images.get(f"photo/{frame}", images[f"render/{frame}"])
        masks, truth = scene.masks(), scene.truth().get(frame, {})
        named = {row["query"]: row for row in answers[:NAMED_OBJECTS]}
        is_scored = answers[0]["iou"] is not None
        captions = {q: f"{q} {row['iou']:.2f}" if is_scored else q for q, row in named.items()}
        predicted = {q: masks.get((row["protocol"], frame, q)) for q, row in named.items()}
        caption = f"predicted masks in {frame}" + ", with IoU" * is_scored
        picture = _draw_masks(ground, captions, predicted)
        blocks.append(Gallery([Picture.of(picture, LARGE, caption)], "main"))
        if any(truth[query].any() for query in named if query in truth):
            small["ground truth"] = _draw_masks(ground, {query: query for query in named}, truth)
        best_first = sort_worst_first(answers)[::-1] or answers
        places = np.linspace(0, len(best_first) - 1, min(ANSWERS, len(best_first)))
        chosen = [best_first[int(place)] for place in places.round()]
        title = "Answers" + " from best to worst" * is_scored
        answer_cards = [answer_card(r, images, lost_by.get(key_of(r), ""), False) for r in chosen]
        cards = [Prose(f"**{title}**", ""), ANSWER_TERMS, Cards(answer_cards)]
    if len(inputs) > 1:
        (start, start_image), (end, end_image) = list(inputs.items())[:2]
        steps = {f"context view {start}": start_image}
        steps |= {f"rendered, {way}": image for way, image in _between(images).items()}
        steps[f"context view {end}"] = end_image
        blocks.append(_gallery(steps, SLIDER, "walk"))
    blocks += [_gallery(small, ANSWER, "strip-of"), *cards]
    title = f"Example: {scene.name}"
    return Section(title, blocks, "example", reason, "Example", style="example", only_html=True)


def _gallery(images: Images, width: int, layout: str) -> Gallery:
    """Return pictures by caption side by side."""
    pictures = [Picture.of(image, width, caption) for caption, image in images.items()]
    return Gallery(pictures, layout)


def scene_fold(scene: Scene, id: str, rows: Sequence[Row], images: Images) -> Fold:
    """Return the collapsed pictures of all views of a scene, if any, and a table of all queries."""
    blocks: list[Block] = []
    if images:
        terms = {"objects": "one colour and number per object, as printed by slgaussian objects"}
        if "near" in scene.metrics:
            near, far = scene.metrics["near"], scene.metrics["far"]
            terms["depth"] = f"{near:.3g} (red) to {far:.3g} scene units (blue)"
        if _frames(images, "depth_error"):
            terms["depth error"] = f"relative, 0 (black) to {ERROR_TOP} and more (white)"
        rows_of_pictures = [
            {
                f"{title} {name}": images[f"{kind}/{name}"]
                for kind, title in VIEW_PICTURES.items()
                if f"{kind}/{name}" in images
            }
            for name in (*_frames(images, "input"), *_frames(images, "photo"))
        ]
        rows_of_pictures.append(_between(images))
        blocks = [Terms(terms), *(_gallery(row, SMALL, "grid tiles") for row in rows_of_pictures)]
    if rows:
        blocks.append(_queries_table(rows))
    iou = f"IoU {scene.metrics['iou']:.3f}, " if "iou" in scene.metrics else ""
    summary = f"{scene.name}: {iou}{count_text(len(rows), 'query', 'queries')}"
    return Fold(summary, blocks, id, only_html=True)


def _between(images: Images) -> dict[str, np.ndarray]:
    """Return the views rendered between the first two cameras."""
    return {way: images[f"render/{way}"] for way in ALONG_THE_WAY if f"render/{way}" in images}


def _queries_table(rows: Sequence[Row]) -> Table:
    marks = {None: None, True: Cell("✓", mark="yes"), False: Cell("✗", mark="no")}
    lines = []
    for row in rows:
        hits = marks[row["hit_mask"]], marks[row["hit_box"]]
        scores = number(row["iou"], 3), *hits, number(row["score"], 3)
        lines.append([row["query"], row["frame"], *scores, row["note"]])
    heads = ["Query", Column("Frame", is_text=True), "IoU", "Point in mask", "Point in box",
             "Relevancy", Column("Note", is_text=True)]  # fmt: skip
    return Table.of(heads, lines)


def _frames(images: Images, kind: str) -> list[str]:
    return [name.split("/", 1)[1] for name in images if name.startswith(f"{kind}/")]


def _rows_of_best_frame(rows: Sequence[Row], images: Images) -> list[Row]:
    """Return the answers with pictures of the frame with most scored answers, else most answers."""
    drawn = [row for row in rows if f"mask/{row['frame']}/{row['query']}" in images]
    scored = [row for row in drawn if row["iou"] is not None]
    return max(grouped(scored or drawn, "frame").values(), key=len, default=[])


def _draw_masks(
    image: np.ndarray, captions: Mapping[str, str], masks: Mapping[str, np.ndarray | None]
) -> np.ndarray:
    """Return the enlarged view with the coloured and captioned mask of each query."""
    size = LARGE, round(image.shape[0] * LARGE / image.shape[1])
    large = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
    regions = [
        pictures.Region(caption, cv2.resize(mask.astype(np.float32), size) > 0.5, place)
        for place, (query, caption) in enumerate(captions.items(), 1)
        if (mask := masks.get(query)) is not None
    ]
    return pictures.draw_regions(large, regions, FONT_SIZE)
