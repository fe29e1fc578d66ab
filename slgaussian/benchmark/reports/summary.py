"""Opening of a report: a sentence and a few numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slgaussian.benchmark.baselines import is_variant
from slgaussian.benchmark.evaluate import NOT_UNDERSTOOD
from slgaussian.benchmark.reports.look import SHOWN_SETS
from slgaussian.benchmark.reports.model import Block, Fold, Numbers, Prose, Slot, Terms, escape
from slgaussian.benchmark.reports.scenes import Scene

Row = Mapping[str, Any]

NAMED_METHODS = 4
"""Methods that the first sentence names, if they are not more: the table of scores names all."""

TERMS = {
    "overlap with the truth, IoU, 0 to 1": "the pixels that the answer and the thing have in "
    "common, as a share of those that are in either: 0 is none, 1 is all. The mean over scenes",
    "points that are on the thing": "each answer also points at one pixel: the share of points "
    "that lie on what was asked for",
    "a new view against a photograph, PSNR": "how near a rendered view is to a photograph from "
    "there that was never shown to the method: 20 dB is a tenth of the range off, 30 dB 3 %",
    "a query in a new view": "seconds, with rendering a view that was not seen before; the median",
    "to build the scene": "seconds from photographs to a scene that answers, all methods share it; "
    "the median",
    "small numbers": "where 95% of the means lie if scenes, or the places that they show, are "
    "drawn anew; methods whose ranges overlap much may be equally good",
}
"""Descriptions of the key numbers, by title."""

SCORES = (("iou", "{:.2f}", 1), ("hit_mask", "{:.0f} %", 100))
"""Scores among the key numbers, in the order of :data:`TERMS`: metric, format, factor."""


def summarize(
    scenes: Sequence[Scene],
    by_method: Mapping[str, Sequence[Row]],
    asked: Sequence[Row],
    leading: Sequence[Row],
    manifest: Mapping[str, Any],
    left_out: int,
) -> list[Block]:
    """Summarise a run in a sentence and a few numbers.

    Parameters
    ----------
    scenes : sequence of Scene
    by_method : {method: rows of the spec ``samples``}
        Ours first.
    asked : sequence
        Those of our method by the first protocol.
    leading : rows of the spec ``scores``
        Of all methods by the first protocol.
    manifest : mapping
    left_out : int
        Scenes that are not in the report.
    """
    if not scenes:
        return [Prose("No scene went through.", "lead"), Prose(f"{left_out} left out.")]
    ours, *others = by_method or [""]
    data = list(manifest.get("data", {}).values())
    counts = {len(of["context"]) for of in data if "context" in of}
    ends = dict.fromkeys(map(str, (min(counts), max(counts)))) if counts else {}
    photographs = " ".join(filter(None, (" to ".join(ends), "photographs")))
    alone = len(scenes) == 1
    names = dict.fromkeys(scene.name if alone else scene.dataset for scene in scenes)
    each = "one scene" if alone else f"each of {len(scenes)} scenes"
    text = f"From {photographs} of {each} ({', '.join(map(escape, names))}), a 3D scene was built "
    text += "that answers words. "
    scored = sum(row["iou"] is not None for row in asked)
    things = _counted(scored or len(asked), "thing")
    if scored:
        unseen = all(set(of.get("context", ())).isdisjoint(of.get("targets", ())) for of in data)
        text += f"It was asked for {things}"
        text += " in views that it had not been shown" if unseen else ""
        text += f", as {'was' if len(others) == 1 else 'were'} {compared(others)}" if others else ""
        text += "."
    elif asked:
        text += f"It was asked for {things}; without labels nothing is scored."
    else:
        text += "Nothing was asked of it."
    unknown = sum(row["note"].startswith(NOT_UNDERSTOOD) for row in asked)
    parts = {
        _counted(len(scenes), "scene"): True,
        f"[{left_out} left out](#left-out)": left_out,
        f"{scored} scored quer{'y' if scored == 1 else 'ies'}": asked,
        f"{len(asked) - scored} asked without truth": len(asked) > scored,
        f"{unknown} not understood (IoU 0)": unknown,
    }
    fine = ", ".join(part for part, holds in parts.items() if holds)
    blocks: list[Block] = [Prose(text, "lead"), Prose(f"{fine}.", "soft fine")]
    if numbers := key_numbers(scenes, leading, ours):
        shown = {title: TERMS[title] for title in (*numbers, "small numbers")}
        blocks += [Numbers(numbers), Fold("What these numbers mean", [Terms(shown)])]
    return blocks


def _counted(count: int, unit: str) -> str:
    return f"{count} {unit}{'' if count == 1 else 's'}"


def compared(others: Sequence[str]) -> str:
    """Describe what else was asked: ``2 other methods (a; b) and 1 variant (c)``; "" if nothing.

    A variant is ours with one part changed. More than :data:`NAMED_METHODS` are not named.
    """
    variants = [name for name in others if is_variant(name)]
    methods = [name for name in others if name not in variants]
    return " and ".join(
        _counted(len(names), kind)
        + (f" ({'; '.join(map(escape, names))})" if len(others) <= NAMED_METHODS else "")
        for kind, names in (("other method", methods), ("variant", variants))
        if names
    )


def key_numbers(
    scenes: Sequence[Scene], scores: Sequence[Row], ours: str
) -> dict[str, list[tuple[str, str | Slot, str, str]]]:
    """Return the numbers at the top: how good, how near, how fast, of each of the first data sets.

    ``scores`` are those by the first protocol.
    """
    numbers: dict[str, list[tuple[str, str | Slot, str, str]]] = {}
    sets = list(dict.fromkeys(scene.dataset for scene in scenes))
    _, _, view, query, build, _ = TERMS
    for dataset in sets[:SHOWN_SETS]:
        name = dataset if len(sets) > 1 else ""
        for (metric, form, factor), title in zip(SCORES, TERMS, strict=False):
            by_method = {
                score["method"]: score
                for score in scores
                if (score["metric"], score["dataset"]) == (metric, dataset)
            }
            mine = by_method.pop(ours, None)
            if mine is None:
                continue
            interval = other = ""
            if mine["low"] is not None:
                low, high = (form.format(factor * mine[end]) for end in ("low", "high"))
                interval = f"{low.removesuffix(' %')} to {high}"
            if by_method:
                rivals = [method for method in by_method if not is_variant(method)]
                best = max((by_method[m] for m in rivals or by_method), key=lambda s: s["value"])
                kind = "best other" if rivals else "best variant"
                other = f"{kind}: {form.format(factor * best['value'])}, {best['method']}"
            value = form.format(factor * mine["value"])
            numbers.setdefault(title, []).append((name, value, interval, other))
        near = [s.metrics["psnr"] for s in scenes if s.dataset == dataset and "psnr" in s.metrics]
        if near:
            numbers.setdefault(view, []).append((name, f"{float(np.mean(near)):.1f} dB", "", ""))
        for title, cost in ((query, "view_query"), (build, "build")) if ours else ():
            slot = Slot(f"<!-- {cost} {dataset.encode().hex()} {ours.encode().hex()} -->")
            numbers.setdefault(title, []).append((name, slot, "", ""))
    return numbers
