"""Sections with images: example scenes, answers, and every scene."""

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
    Columns,
    Gallery,
    Picture,
    Prose,
    Section,
    Table,
    Terms,
    number,
)
from slgaussian.benchmark.scores import GOOD, grouped, key_of

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]
Key = tuple[str, str, str]

LOOKS = 3
"""Number of data sets with an example scene at the top."""

NAMED_OBJECTS = 10
"""Largest number of captions in one image."""

LARGE, LETTERS = 960, 24
"""Width of an image with captions, and their font size, pixels."""

WALK, ANSWER, SMALL = 800, 480, 360
"""Widths of images of the slider, of answers, and in the section of a scene, pixels."""

WORST, OF_A_SCENE = 8, 2
"""Number of answers with the lowest scores shown for a run, and their maximum per scene."""

ANSWERS = 4
"""Number of answers shown for a scene."""

FAIR = 0.25
"""Smallest IoU of an answer that is not poor."""

ANSWER_TERMS = Terms(
    {
        "found": "in colour, outlined; all else is dimmed",
        "truth": "its outline",
        "point": "the one pixel that an answer points at, ✓ on the thing, ✗ beside it",
        "IoU": "what found and truth have in common, as a share of both together, 0 to 1",
        "relevancy": "how much better than “object”, “thing” or “stuff” the words fit, 0 to 1; "
        "grey where they fit least and yellow where they fit best in this picture, with both ends",
    },
    {
        "found": "swatch predicted",
        "truth": "swatch true",
        "point": "dot",
        "relevancy": "bar relevancy",
    },
)


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a report; images are read on demand, one scene at a time.

    Attributes
    ----------
    name, dataset : str
    rows : sequence
        Rows of the spec ``samples``: our method first, then the others.
    metrics : {name: float}
        ``scene_metrics`` of our result.
    pictures : function giving {name: uint8 [H, W, 3]}
        Pictures of our result.
    truth : function giving {frame: {query: bool [H, W]}}
    masks : function giving {(protocol, frame, query): bool [H, W]}
        Our masks.
    """

    name: str
    dataset: str
    rows: Sequence[Row]
    metrics: Mapping[str, float]
    pictures: Callable[[], Images]
    truth: Callable[[], Mapping[str, Images]]
    masks: Callable[[], Mapping[Key, np.ndarray]]


def choose_scenes(scenes: Iterable[tuple[str, str, Mapping[str, float]]]) -> dict[str, str]:
    """Choose an example scene of each of the first data sets; return the reasons by name.

    ``scenes`` are name, data set and metrics. It is the scene of median IoU, which is typical; the
    first scene if there is no IoU.
    """
    by_set: dict[str, list[tuple[str, float | None]]] = {}
    for name, dataset, metrics in scenes:
        by_set.setdefault(dataset, []).append((name, metrics.get("iou")))
    chosen = {}
    for dataset, members in list(by_set.items())[:LOOKS]:
        scored = sorted((iou, name) for name, iou in members if iou is not None)
        name = scored[(len(scored) - 1) // 2][1] if scored else members[0][0]
        place = "in the middle by IoU" if scored else "the first"
        chosen[name] = f"{place} of the {len(members)} scenes of {dataset}" if members[1:] else ""
    return chosen


def sort_worst_first(rows: Iterable[Row]) -> list[Row]:
    """Sort the scored rows by IoU; among equal ones, rows with a wrong point come first."""
    scored = [row for row in rows if row["iou"] is not None]
    return sorted(scored, key=lambda row: (row["iou"], bool(row["hit_mask"]), bool(row["hit_box"])))


def limit_per_scene(rows: Sequence[Row], count: int) -> list[Row]:
    """Return the first ``count`` rows, at most :data:`OF_A_SCENE` per scene if there are enough.

    A query occurs once per scene, independent of its number of frames.
    """
    limit = max(OF_A_SCENE, -(-count // (len({row["scene"] for row in rows}) or 1)))
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


def answer_card(
    row: Row, images: Images, width: int, lost_by: str = "", is_placed: bool = True
) -> Card:
    """Return an answer as a card; with ``is_placed`` its note contains scene and frame."""
    query = row["query"]
    chips = []
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
        Picture.of(images[f"mask/{name}"], width, "found", f"mask found for {query}"),
        Picture.of(images[f"relevancy/{name}"], width, "relevancy", f"relevancy of {query}"),
    ]
    note = [f"{row['scene']}, {row['frame']}"] * is_placed + [row["note"]] * bool(row["note"])
    return Card(query, chips, panels, ": ".join(note))


def look_section(
    scene: Scene, reason: str, rows: Sequence[Row], images: Images, lost_by: Mapping[Key, str]
) -> Section:
    """Return the section of an example scene: all answers in one view, a slider, and some answers.

    ``rows`` are those of our method in the first protocol.
    """
    inputs = {name: images[f"input/{name}"] for name in _frames(images, "input")}
    answers = _of_busiest_frame(rows, images)
    frame = answers[0]["frame"] if answers else next(iter(_frames(images, "photo")), "")
    stage: list[Block] = []
    strip = [
        Picture.of(image, ANSWER, f"given: photograph {name}",
                   f"given photograph {name} of {scene.name}")
        for name, image in inputs.items()
    ]  # fmt: skip
    if f"photo/{frame}" in images:
        caption = f"photograph {frame}, never shown to the method"
        strip.append(
            Picture.of(images[f"photo/{frame}"], ANSWER, caption, f"{caption}, {scene.name}")
        )
        strip.append(Picture.of(images[f"render/{frame}"], ANSWER, "the same view, rendered"))
    cards: list[Block] = []
    if answers:
        ground = images.get(f"photo/{frame}", images[f"render/{frame}"])
        masks, truth = scene.masks(), scene.truth().get(frame, {})
        named = {row["query"]: row for row in answers[:NAMED_OBJECTS]}
        is_scored = answers[0]["iou"] is not None
        texts = {q: f"{q} {row['iou']:.2f}" if is_scored else q for q, row in named.items()}
        predicted = {q: masks.get((row["protocol"], frame, q)) for q, row in named.items()}
        caption = f"found by its words in {frame}"
        caption += ", each with its overlap with the truth (IoU)" if is_scored else ""
        alt = f"everything found in {frame} of {scene.name}"
        picture = _draw_named(ground, texts, predicted)
        stage.append(Gallery([Picture.of(picture, LARGE, caption, alt)], "grid"))
        if any(truth[q].any() for q in named if q in truth):
            picture = _draw_named(ground, {q: q for q in named}, truth)
            caption = "the truth: what labels say is there"
            alt = f"truth of {frame} of {scene.name}"
            strip.append(Picture.of(picture, ANSWER, caption, alt))
        best_first = sort_worst_first(answers)[::-1] or answers
        places = np.linspace(0, len(best_first) - 1, min(ANSWERS, len(best_first)))
        title = "Asked in words" + ": from the best answer to the worst" * is_scored
        chosen = [best_first[int(place)] for place in places.round()]
        drawn = [answer_card(r, images, ANSWER, lost_by.get(key_of(r), ""), False) for r in chosen]
        cards = [Prose(f"**{title}**", ""), ANSWER_TERMS, Cards(drawn)]
    if len(inputs) > 1:
        (start, start_image), (end, end_image) = list(inputs.items())[:2]
        steps = {f"photograph {start}": start_image}
        steps |= {f"rendered, {way}": image for way, image in _along_the_way(images).items()}
        steps[f"photograph {end}"] = end_image
        walk = [
            Picture.of(image, WALK, name, f"{name} of {scene.name}")
            for name, image in steps.items()
        ]
        stage.append(Gallery(walk, "walk"))
    blocks: list[Block] = [Columns(stage), Gallery(strip, "strip-of"), *cards]
    return Section(scene.name, blocks, note=reason, style="look", only_html=True)


def scene_section(scene: Scene, id: str, rows: Sequence[Row], images: Images) -> Section:
    """Return the section of a scene: photographs, objects, depth, new views and every query.

    Without ``images`` it contains only the table.
    """
    blocks: list[Block] = []
    if images:
        blocks = _view_blocks(images, scene.metrics)
    elif rows:
        blocks.append(Prose("Answered better than the scenes that are drawn here."))
    if rows:
        blocks.append(_queries_table(rows))
    note = f"IoU {scene.metrics['iou']:.3f}; " if "iou" in scene.metrics else ""
    note += f"objects, depth and {len(rows)} queries"
    return Section(scene.name, blocks, id, note, is_folded=True, only_html=True)


def _view_blocks(images: Images, metrics: Mapping[str, float]) -> list[Block]:
    """Return a row of images for each photograph, for each target, and for the views between."""
    terms = {
        "objects": "one colour and number an object, the same in all photographs, as "
        "`slgaussian objects` has them"
    }
    if "near" in metrics:
        terms["depth"] = f"{metrics['near']:.3g} (red) to {metrics['far']:.3g} scene units (blue)"
    if _frames(images, "depth_error"):
        terms["depth error"] = f"relative, 0 (black) to {ERROR_TOP} and more (white)"
    kinds = {
        "input": "given",
        "labels": "objects",
        "depth": "depth",
        "true_depth": "true depth",
        "depth_error": "depth error",
        "photo": "photograph, never shown to the method",
        "render": "rendered",
        "ids": "objects, rendered",
    }
    frames = [*_frames(images, "input"), *_frames(images, "photo")]
    rows = [
        [
            Picture.of(images[f"{kind}/{name}"], SMALL, f"{title} {name}", f"{title} of {name}")
            for kind, title in kinds.items()
            if f"{kind}/{name}" in images
        ]
        for name in frames
    ]
    rows.append([Picture.of(image, SMALL, way) for way, image in _along_the_way(images).items()])
    return [
        Terms(terms),
        *(Gallery(row, "grid five" if len(row) == 5 else "grid three") for row in rows),
    ]


def _along_the_way(images: Images) -> dict[str, np.ndarray]:
    """Return the views rendered between the first two cameras."""
    return {way: images[f"render/{way}"] for way in ALONG_THE_WAY if f"render/{way}" in images}


def _queries_table(rows: Sequence[Row]) -> Table:
    marks = {None: None, True: Cell("✓", mark="yes"), False: Cell("✗", mark="no")}
    lines = [
        [
            row["query"],
            row["frame"],
            number(row["iou"], 3),
            marks[row["hit_mask"]],
            marks[row["hit_box"]],
            number(row["score"], 3),
            row["note"],
        ]
        for row in rows
    ]
    heads = ["Query", Column("Frame", is_text=True), "IoU", "Point in mask", "Point in box",
             "Relevancy", Column("Note", is_text=True)]  # fmt: skip
    return Table.of(heads, lines)


def _frames(images: Images, kind: str) -> list[str]:
    return [name.split("/", 1)[1] for name in images if name.startswith(f"{kind}/")]


def _of_busiest_frame(rows: Sequence[Row], images: Images) -> list[Row]:
    """Return the drawn answers of the frame with most scored answers, else most answers."""
    drawn = [row for row in rows if f"mask/{row['frame']}/{row['query']}" in images]
    scored = [row for row in drawn if row["iou"] is not None]
    return max(grouped(scored or drawn, "frame").values(), key=len, default=[])


def _draw_named(
    ground: np.ndarray, texts: Mapping[str, str], masks: Mapping[str, np.ndarray | None]
) -> np.ndarray:
    """Return the enlarged view with the coloured and captioned mask of each query."""
    size = LARGE, round(ground.shape[0] * LARGE / ground.shape[1])
    large = cv2.resize(ground, size, interpolation=cv2.INTER_CUBIC)
    named = [
        pictures.Named(text, cv2.resize(mask.astype(np.float32), size) > 0.5, place)
        for place, (query, text) in enumerate(texts.items(), 1)
        if (mask := masks.get(query)) is not None
    ]
    return pictures.show_named(large, named, LETTERS)
