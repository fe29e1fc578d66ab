"""Sections of pictures: a scene to look at, answers, and every scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from slgaussian.benchmark import pictures
from slgaussian.benchmark.evaluate import ALONG_THE_WAY, ERROR_TOP
from slgaussian.benchmark.pictures import Named
from slgaussian.benchmark.reports.encoding import picture
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
from slgaussian.benchmark.scores import GOOD, key_of

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]
Key = tuple[str, str, str]

SHOWN_SETS = 3
"""Data sets of which a scene is shown at the top."""

SHOWN_NAMES = 10
"""Names that are written onto one picture, at most."""

LARGE, LETTERS = 960, 24
"""Width of a picture with names, and the size of their letters, pixels."""

SHOWN, ANSWER = 800, 480
"""Width of pictures that open the page, and of answers, pixels."""

SMALL = 360
"""Width of the pictures in the section of a scene, pixels."""

WORST = 8
"""Answers of a run that are shown, those that scored least."""

OF_A_SCENE = 2
"""Shown answers that are of one scene at most, unless there are too few scenes."""

ANSWERS = 4
"""Answers of a scene that are shown."""

FAIR = 0.25
"""Least IoU of an answer that is not poor."""

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


def choose_scenes(scenes: Iterable[tuple[str, str, Mapping[str, float]]]) -> dict[str, str]:
    """Choose a scene to show of each of the first data sets; return the reason by name.

    ``scenes`` are name, data set and metrics. Of those with an IoU it is the middle one, so that
    what is shown is typical; without, the first.
    """
    by_set: dict[str, list[tuple[str, float | None]]] = {}
    for name, dataset, metrics in scenes:
        by_set.setdefault(dataset, []).append((name, metrics.get("iou")))
    chosen = {}
    for dataset, own in list(by_set.items())[:SHOWN_SETS]:
        scored = sorted((iou, name) for name, iou in own if iou is not None)
        name = scored[(len(scored) - 1) // 2][1] if scored else own[0][0]
        place = "in the middle by IoU" if scored else "the first"
        chosen[name] = f"{place} of the {len(own)} scenes of {dataset}" if own[1:] else ""
    return chosen


def ranked(rows: Iterable[Row]) -> list[Row]:
    """Sort the scored rows, worst first: by IoU, and of equal ones those that point elsewhere."""
    scored = [row for row in rows if row["iou"] is not None]
    return sorted(scored, key=lambda row: (row["iou"], bool(row["hit_mask"]), bool(row["hit_box"])))


def few_a_scene(rows: Sequence[Row], count: int) -> list[Row]:
    """Return the first ``count`` rows, few of any scene, and of each data set its share.

    A query is there once a scene, whatever the number of frames that it is asked in.
    """
    sets, scenes = (len({row[name] for row in rows}) or 1 for name in ("dataset", "scene"))
    limits = {"scene": max(OF_A_SCENE, -(-count // scenes))}
    taken: Counter[tuple[str, str]] = Counter()
    chosen: dict[tuple[str, str], int] = {}
    # Where a data set has not its share, the others fill the places.
    for most in (limits | {"dataset": -(-count // sets)}, limits):
        for place, row in enumerate(rows):
            query = row["scene"], row["query"]
            full = any(taken[name, row[name]] >= limit for name, limit in most.items())
            if len(chosen) < count and not full and query not in chosen:
                taken.update((name, row[name]) for name in ("scene", "dataset"))
                chosen[query] = place
    return [rows[place] for place in sorted(chosen.values())]


def answer_card(
    row: Row, images: Images, width: int, lost_by: str = "", place: bool = True
) -> Card:
    """Return an answer as a card; with ``place`` it says of which scene and frame it is."""
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
    drawn = [
        picture(images[f"mask/{name}"], width, "found", f"mask found for {query}"),
        picture(images[f"relevancy/{name}"], width, "relevancy", f"relevancy of {query}"),
    ]
    note = [f"{row['scene']}, {row['frame']}"] * place + [row["note"]] * bool(row["note"])
    return Card(query, chips, drawn, ": ".join(note))


def look_section(
    scene: str,
    reason: str,
    rows: Sequence[Row],
    images: Images,
    truth: Mapping[str, Images],
    found: Mapping[tuple[str, str, str], np.ndarray],
    lost_by: Mapping[Key, str],
) -> Section:
    """Return a scene to look at: everything found in one view, a walk, and some answers.

    ``rows`` are ours by the first protocol, ``found`` our masks.
    """
    inputs = {name: images[f"input/{name}"] for name in _frames(images, "input")}
    frame, asked = _most_asked(rows, images)
    frame = frame or next(iter(_frames(images, "photo")), "")
    stage: list[Block] = []
    strip = [
        picture(image, ANSWER, f"given: photograph {name}", f"given photograph {name} of {scene}")
        for name, image in inputs.items()
    ]
    if f"photo/{frame}" in images:
        caption = f"photograph {frame}, never shown to the method"
        strip.append(picture(images[f"photo/{frame}"], ANSWER, caption, f"{caption}, {scene}"))
        strip.append(picture(images[f"render/{frame}"], ANSWER, "the same view, rendered"))
    cards: list[Block] = []
    if asked:
        ground = images.get(f"photo/{frame}", images.get(f"render/{frame}"))
        assert ground is not None  # a frame that was drawn was chosen
        scored = any(row["iou"] is not None for row in asked)
        shown = asked[:SHOWN_NAMES]
        caption = f"found by its words in {frame}"
        caption += ", each with its overlap with the truth (IoU)" if scored else ""
        masks = [found.get((row["protocol"], frame, row["query"])) for row in shown]
        texts = [
            row["query"] if row["iou"] is None else f"{row['query']} {row['iou']:.2f}"
            for row in shown
        ]
        alt = f"everything found in {frame} of {scene}"
        stage.append(Gallery([picture(_named(ground, texts, masks), LARGE, caption, alt)], "grid"))
        known = [truth.get(frame, {}).get(row["query"]) for row in shown]
        if any(mask is not None and mask.any() for mask in known):
            labelled = _named(ground, [row["query"] for row in shown], known)
            caption = "the truth: what labels say is there"
            strip.append(picture(labelled, ANSWER, caption, f"truth of {frame} of {scene}"))
        best_first = ranked(asked)[::-1] or asked
        places = np.linspace(0, len(best_first) - 1, min(ANSWERS, len(best_first)))
        spread = [best_first[int(k)] for k in places.round()]
        title = "Asked in words: from the best answer to the worst" if scored else "Asked in words"
        cards = [Prose(f"**{title}**", ""), ANSWER_TERMS]
        cards.append(
            Cards(
                [
                    answer_card(row, images, ANSWER, lost_by.get(key_of(row), ""), False)
                    for row in spread
                ]
            )
        )
    if len(inputs) > 1:
        stage.append(Gallery(_walk(scene, inputs, images), "walk"))
    blocks: list[Block] = [Columns(stage), Gallery(strip, "strip-of"), *cards]
    return Section(scene, blocks, note=reason, style="look", only_html=True)


def _walk(scene: str, inputs: Images, images: Images) -> list[Picture]:
    """Return what is seen from the first photograph to the second, rendered between them."""
    (first, before), (second, after) = list(inputs.items())[:2]
    steps = {f"photograph {first}": before}
    steps |= {
        f"rendered, {way}": images[f"render/{way}"]
        for way in ALONG_THE_WAY
        if f"render/{way}" in images
    }
    steps[f"photograph {second}"] = after
    return [picture(image, SHOWN, name, f"{name} of {scene}") for name, image in steps.items()]


def scene_section(
    scene: str,
    id: str,
    rows: Sequence[Row],
    metrics: Mapping[str, float],
    images: Images,
    exhibited: bool,
) -> Section:
    """Return all of a scene: photographs, objects, depth, new views, answers and every query.

    Without ``images`` there are only tables. Of a scene that is ``exhibited`` at the top the
    pictures there are not repeated.
    """
    blocks: list[Block] = []
    if images:
        blocks += _depth_blocks(images, metrics)
        blocks += [] if exhibited else _view_blocks(images)
    elif rows:
        blocks.append(Prose("Answered better than the scenes that are drawn here."))
    drawn = [row for row in rows if f"mask/{row['frame']}/{row['query']}" in images]
    if drawn and not exhibited:
        worst_first = ranked(drawn)
        half = ANSWERS // 2
        chosen = [*worst_first[:half], *worst_first[half:][-half:]] or drawn[:ANSWERS]
        blocks.append(Cards([answer_card(row, images, SMALL) for row in chosen], "narrow"))
        if len(chosen) < len(rows):
            blocks.append(Prose(f"The worst and the best of {len(rows)} questions."))
    if rows:
        blocks.append(_queries_table(rows))
    note = f"IoU {metrics['iou']:.3f}; " if "iou" in metrics else ""
    note += f"objects, depth and {len(rows)} queries"
    return Section(scene, blocks, id, note, is_folded=True, only_html=True)


def _depth_blocks(images: Images, metrics: Mapping[str, float]) -> list[Block]:
    terms = {
        "objects": "one colour and number an object, the same in all photographs, as "
        "`slgaussian objects` has them"
    }
    if "near" in metrics:
        terms["depth"] = f"{metrics['near']:.3g} (red) to {metrics['far']:.3g} scene units (blue)"
    if _frames(images, "depth_error"):
        terms["depth error"] = f"relative, 0 (black) to {ERROR_TOP} and more (white)"
    kinds = {
        "input": "",
        "labels": "objects",
        "depth": "depth",
        "true_depth": "true depth",
        "depth_error": "depth error",
    }
    return [Terms(terms), *(_row(images, kinds, name) for name in _frames(images, "input"))]


def _view_blocks(images: Images) -> list[Block]:
    """Return new views: the photographs, which the method never saw, or those along the way."""
    targets = _frames(images, "photo")
    if targets:
        kinds = {"photo": "photograph, never shown to the method", "render": "rendered",
                 "ids": "objects, rendered"}  # fmt: skip
        rows = [_row(images, kinds, name) for name in targets]
    else:
        path = [way for way in ALONG_THE_WAY if f"render/{way}" in images]
        shown = [picture(images[f"render/{way}"], SMALL, way) for way in path]
        rows = [Gallery(shown, "grid three")]
    return [Prose("**Seen from new viewpoints**", ""), *rows]


def _row(images: Images, kinds: Mapping[str, str], name: str) -> Gallery:
    """Return what there is of a frame, a picture a kind."""
    shown = [
        picture(
            images[f"{kind}/{name}"], SMALL, title or name, f"{title} of {name}" if title else name
        )
        for kind, title in kinds.items()
        if f"{kind}/{name}" in images
    ]
    return Gallery(shown, "grid five" if len(shown) == 5 else "grid three")


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


def _most_asked(rows: Sequence[Row], images: Images) -> tuple[str, list[Row]]:
    """Return the frame with the most answers that are scored, or the most at all, and its rows."""
    by_frame: dict[str, list[Row]] = {}
    for row in rows:
        if f"mask/{row['frame']}/{row['query']}" in images:
            by_frame.setdefault(row["frame"], []).append(row)
    if not by_frame:
        return "", []
    scored = {
        frame: [row for row in own if row["iou"] is not None] for frame, own in by_frame.items()
    }
    frame = max(by_frame, key=lambda name: (len(scored[name]), len(by_frame[name])))
    return frame, scored[frame] or by_frame[frame]


def _named(
    ground: np.ndarray, texts: Sequence[str], masks: Sequence[np.ndarray | None]
) -> np.ndarray:
    """Return the view, enlarged, with the mask of each text in its colour."""
    size = LARGE, round(ground.shape[0] * LARGE / ground.shape[1])
    large = cv2.resize(ground, size, interpolation=cv2.INTER_CUBIC)
    named = [
        Named(text, cv2.resize(mask.astype(np.float32), size) > 0.5, place)
        for place, (text, mask) in enumerate(zip(texts, masks, strict=True), 1)
        if mask is not None
    ]
    return pictures.show_named(large, named, LETTERS)
