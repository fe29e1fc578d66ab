"""What a report opens with: what ran, in a sentence and a few numbers, and a scene to look at."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from slgaussian.benchmark import pictures, showcase
from slgaussian.benchmark.baselines import is_variant
from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.evaluate import ALONG_THE_WAY
from slgaussian.benchmark.pictures import Named

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]

SHOWN_SETS = 3
"""Data sets of which a scene is shown at the top, and key numbers stand there."""

SHOWN_METHODS = 4
"""Methods that the first sentence names, if they are not more: the table of scores names all."""

SHOWN_ANSWERS = 4
"""Answers of such a scene: from the best to the worst in even steps."""

SHOWN_NAMES = 10
"""Names that are written onto one picture, at most."""

LARGE, LETTERS = 960, 24
"""Width of a picture with names, and the size of their letters, pixels."""


@dataclass(frozen=True)
class KeyNumber:
    """A number at the top of a report.

    Attributes
    ----------
    title, value, about : str
        What it is in a few words, as it is printed, and in a sentence. A value that is only known
        where and when it ran is a :func:`slot`.
    interval : str
        Where it lies, as printed.
    other : str
        The same of the best other method, or of the best variant of ours where nothing else ran,
        with its name; empty if there is neither.
    """

    title: str
    value: str
    about: str
    interval: str = ""
    other: str = ""


SCORES = (
    (
        "iou",
        "overlap with the truth, IoU, 0 to 1",
        "the pixels that the answer and the thing have in common, as a share of those that are in "
        "either: 0 is none, 1 is all. The mean over scenes",
        "{:.2f}",
        1,
    ),
    (
        "hit_mask",
        "points that are on the thing",
        "each answer also points at one pixel: the share of points that lie on what was asked for",
        "{:.0f} %",
        100,
    ),
)
"""Of the scores that stand at the top: metric, title, about, format, factor."""

PSNR_ABOUT = (
    "how near a rendered view is to a photograph from there that was never shown to the method: "
    "20 dB is a tenth of the range off, 30 dB a thirtieth"
)
QUERY_ABOUT = "seconds, with rendering a view that was not seen before; the median"
BUILD_ABOUT = "seconds from photographs to a scene that answers, all methods share it; the median"


def compared(others: Sequence[str]) -> str:
    """What else was asked, as words: ``2 other methods (a; b) and 1 variant (c)``; "" if nothing.

    A variant is ours with one part changed. More than :data:`SHOWN_METHODS` are not named.
    """
    said = []
    for kind, own in (
        ("other method", [name for name in others if not is_variant(name)]),
        ("variant", [name for name in others if is_variant(name)]),
    ):
        if own:
            names = f" ({'; '.join(own)})" if len(others) <= SHOWN_METHODS else ""
            said.append(f"{len(own)} {kind}{'' if len(own) == 1 else 's'}{names}")
    return " and ".join(said)


@dataclass(frozen=True)
class Exhibit:
    """A scene to look at, pictures not yet encoded.

    Attributes
    ----------
    scene : str
    photographs : {name: uint8 [H, W, 3]}
        Those that the method was given.
    walk : {caption: uint8 [H, W, 3]}
        From the first photograph to the second, with what was rendered between them.
    frame : str
        The view that was asked, empty if none was.
    told, truth : uint8 [H, W, 3] or None
        That view with everything found, or labelled, in colour and named.
    view : {caption: uint8 [H, W, 3]}
        A photograph that was never shown, and what was rendered there.
    rows : list
        Answers that are shown one by one.
    """

    scene: str
    photographs: Images
    walk: Images
    frame: str
    told: np.ndarray | None
    truth: np.ndarray | None
    view: Images
    rows: list[Row] = field(default_factory=list)


def choose_scenes(scenes: Iterable[tuple[str, str, Mapping[str, float]]]) -> dict[str, str]:
    """The scene to show of each of the first data sets, and why it: by name.

    ``scenes`` are name, data set and metrics. Of those with an IoU it is the middle one, so that
    what is shown is typical; without, the first.
    """
    by_set: dict[str, list[tuple[str, float | None]]] = {}
    for name, dataset, metrics in scenes:
        by_set.setdefault(dataset, []).append((name, metrics.get("iou")))
    chosen = {}
    for dataset, own in list(by_set.items())[:SHOWN_SETS]:
        scored = sorted((iou, name) for name, iou in own if iou is not None)
        if scored:
            name = scored[(len(scored) - 1) // 2][1]
            why = "" if len(own) == 1 else f"in the middle of the {len(own)} scenes of {dataset}"
        else:
            name = own[0][0]
            why = "" if len(own) == 1 else f"the first of the {len(own)} scenes of {dataset}"
        chosen[name] = why
    return chosen


def exhibit(
    scene: str,
    rows: Sequence[Row],
    images: Images,
    truth: Callable[[], Mapping[str, Images]],
    found: Callable[[], Mapping[tuple[str, str, str], np.ndarray]],
) -> Exhibit:
    """What is shown of a scene: ``rows`` are ours by the first protocol, ``found`` our masks."""
    photographs = {name: images[f"input/{name}"] for name in _frames(images, "input")}
    walk = {}
    if len(photographs) > 1:
        (first, before), (second, after) = list(photographs.items())[:2]
        between = {
            f"rendered, {way}": images[f"render/{way}"]
            for way in ALONG_THE_WAY
            if f"render/{way}" in images
        }
        walk = {f"photograph {first}": before, **between, f"photograph {second}": after}
    frame, own = _most_asked(rows, images)
    if not own:
        seen = _frames(images, "photo")
        view = _view(images, seen[0]) if seen else {}
        return Exhibit(scene, photographs, walk, "", None, None, view)
    ground = images.get(f"photo/{frame}", images.get(f"render/{frame}"))
    assert ground is not None  # _most_asked chose a frame that was drawn
    masks, known = found(), truth().get(frame, {})
    shown = own[:SHOWN_NAMES]
    told = _named(
        ground,
        [
            (_with_score(row), masks.get((row["protocol"], frame, row["query"])), number)
            for number, row in enumerate(shown, 1)
        ],
    )
    true = [(row["query"], known.get(row["query"]), number) for number, row in enumerate(shown, 1)]
    labelled = any(mask is not None and mask.any() for _, mask, _ in true)
    return Exhibit(
        scene,
        photographs,
        walk,
        frame,
        told,
        _named(ground, true) if labelled else None,
        _view(images, frame),
        _spread(own),
    )


def slot(what: str, dataset: str, method: str) -> str:
    """A comment where :func:`fill` puts what was measured of a method on a data set."""
    return f"<!-- {what} {dataset.encode().hex()} {method.encode().hex()} -->"


def fill(page: str, costs: Iterable[Cost]) -> str:
    """The page with every :func:`slot` filled, each in an element of class ``took``.

    Seconds have two digits that count, and memory is in megabytes; a dash stands for what was not
    measured.
    """
    known = {(cost.dataset, cost.method): cost for cost in costs}

    def one(match: re.Match[str]) -> str:
        dataset, method = (bytes.fromhex(match[k]).decode() for k in (2, 3))
        value = getattr(known.get((dataset, method)), match[1], None)
        if value is None:
            text = "–"
        elif match[1] in ("grown", "peak"):
            text = f"{value / 1e6:,.0f}"
        else:
            text = f"{value:,.0f}" if value >= 10 else f"{value:.2g}"
        return f'<span class="took">{text}</span>'

    return re.sub(r"<!-- (\w+) ((?:[0-9a-f]{2})*) ((?:[0-9a-f]{2})*) -->", one, page)


def key_numbers(
    dataset: str, scores: Sequence[Row], metrics: Sequence[Mapping[str, float]], ours: str
) -> list[KeyNumber]:
    """What stands at the top of a data set: how good, how near, how fast.

    ``scores`` are those of the data set by the first protocol, ``metrics`` of its scenes.
    """
    found = []
    for metric, title, about, form, factor in SCORES:
        by_method = {score["method"]: score for score in scores if score["metric"] == metric}
        mine = by_method.pop(ours, None)
        if mine is None:
            continue
        interval = other = ""
        if mine["low"] is not None:
            low, high = (form.format(factor * mine[end]) for end in ("low", "high"))
            interval = f"{low.removesuffix(' %')} to {high}"
        if by_method:
            others = [name for name in by_method if not is_variant(name)]
            best = max((by_method[name] for name in others or by_method),
                       key=lambda score: score["value"])  # fmt: skip
            what = "best other" if others else "best variant"
            other = f"{what}: {form.format(factor * best['value'])}, {best['method']}"
        value = form.format(factor * mine["value"])
        found.append(KeyNumber(title, value, about, interval, other))
    near = [own["psnr"] for own in metrics if "psnr" in own]
    if near:
        title = "a new view against a photograph, PSNR"
        found.append(KeyNumber(title, f"{float(np.mean(near)):.1f} dB", PSNR_ABOUT))
    if ours:
        query, build = (slot(what, dataset, ours) for what in ("view_query", "build"))
        found.append(KeyNumber("a query in a new view", query, QUERY_ABOUT))
        found.append(KeyNumber("to build the scene", build, BUILD_ABOUT))
    return found


def _frames(images: Images, kind: str) -> list[str]:
    return [name.split("/", 1)[1] for name in images if name.startswith(f"{kind}/")]


def _view(images: Images, frame: str) -> Images:
    captions = {
        "photo": f"photograph {frame}, never shown to the method",
        "render": "the same view, rendered",
    }
    if f"photo/{frame}" not in images:
        return {}
    return {
        caption: images[f"{kind}/{frame}"]
        for kind, caption in captions.items()
        if f"{kind}/{frame}" in images
    }


def _most_asked(rows: Sequence[Row], images: Images) -> tuple[str, list[Row]]:
    """The frame with the most answers that are scored, or the most at all, and its rows."""
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


def _spread(rows: Sequence[Row]) -> list[Row]:
    """From the best answer to the worst in even steps; the first ones if none is scored."""
    ranked = showcase.ranked(rows)[::-1]
    if not ranked:
        return list(rows[:SHOWN_ANSWERS])
    count = min(SHOWN_ANSWERS, len(ranked))
    return [ranked[k] for k in np.linspace(0, len(ranked) - 1, count).round().astype(int)]


def _with_score(row: Row) -> str:
    return row["query"] if row["iou"] is None else f"{row['query']} {row['iou']:.2f}"


def _named(ground: np.ndarray, known: Sequence[tuple[str, np.ndarray | None, int]]) -> np.ndarray:
    """The view, enlarged, with what is known of each text in its colour."""
    height, width = round(ground.shape[0] * LARGE / ground.shape[1]), LARGE
    large = cv2.resize(ground, (width, height), interpolation=cv2.INTER_CUBIC)
    named = [
        Named(text, _enlarged(mask, (width, height)), number)
        for text, mask, number in known
        if mask is not None
    ]
    return pictures.show_named(large, named, LETTERS)


def _enlarged(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    smooth = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return smooth > 0.5
