"""Summary at the top of a report: a sentence and key numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slgaussian.benchmark.baselines import is_variant
from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.evaluate import NOT_UNDERSTOOD
from slgaussian.benchmark.reports.look import LOOKS, Scene
from slgaussian.benchmark.reports.model import Block, Fold, Numbers, Prose, Terms, escape

Row = Mapping[str, Any]

COSTS = "<!-- costs -->"
"""Placeholder of the seconds, see :func:`cost_numbers`."""

VIEW, QUERY = "a new view against a photograph, PSNR", "a query in a new view"
BUILD, RANGE = "to build the scene", "small numbers"

TERMS = {
    "overlap with the truth, IoU, 0 to 1": "the pixels that the answer and the thing have in "
    "common, as a share of those that are in either: 0 is none, 1 is all. The mean over scenes",
    "points that are on the thing": "each answer also points at one pixel: the share of points "
    "that lie on what was asked for",
    VIEW: "how near a rendered view is to a photograph from "
    "there that was never shown to the method: 20 dB is a tenth of the range off, 30 dB 3 %",
    QUERY: "seconds, with rendering a view that was not seen before; the median",
    BUILD: "seconds from photographs to a scene that answers, all methods share it; the median",
    RANGE: "where 95% of the means lie if scenes, or the places that they show, are "
    "drawn anew; methods whose ranges overlap much may be equally good",
}
"""Descriptions of the key numbers, by title."""

SCORES = (("iou", "{:.2f}", 1), ("hit_mask", "{:.0f} %", 100))
"""Scores among the key numbers, in the order of :data:`TERMS`: metric, format, factor."""


def summarize(
    scenes: Sequence[Scene],
    methods: Sequence[str],
    answers: Sequence[Row],
    scores: Sequence[Row],
    manifest: Mapping[str, Any],
    left_out: int,
) -> list[Block]:
    """Summarise a run in a sentence and key numbers.

    Parameters
    ----------
    scenes : sequence of Scene
    methods : sequence of str
        Ours first.
    answers : rows of the spec ``samples``
        Rows of our method in the first protocol.
    scores : rows of the spec ``scores``
        Scores of all methods in the first protocol.
    manifest : mapping
    left_out : int
        Number of scenes that are not in the report.
    """
    if not scenes:
        return [Prose("No scene went through.", "lead"), Prose(f"{left_out} left out.")]
    data = list(manifest.get("data", {}).values())
    sizes = {len(scene["context"]) for scene in data if "context" in scene}
    ends = dict.fromkeys(map(str, (min(sizes), max(sizes)))) if sizes else {}
    photographs = " ".join(filter(None, (" to ".join(ends), "photographs")))
    is_single = len(scenes) == 1
    names = dict.fromkeys(scene.name if is_single else scene.dataset for scene in scenes)
    each = "one scene" if is_single else f"each of {len(scenes)} scenes"
    text = f"From {photographs} of {each} ({', '.join(map(escape, names))}), a 3D scene was built "
    text += "that answers words. "
    scored = sum(row["iou"] is not None for row in answers)
    things = _count(scored or len(answers), "thing")
    if scored:
        is_held_out = all({*s.get("context", ())}.isdisjoint(s.get("targets", ())) for s in data)
        text += f"It was asked for {things}"
        text += " in views that it had not been shown" if is_held_out else ""
        variants = sum(map(is_variant, methods[1:]))
        counts = {"other method": len(methods) - 1 - variants, "variant": variants}
        rivals = " and ".join(_count(n, kind) for kind, n in counts.items() if n)
        text += f", as were {rivals}." if rivals else "."
    elif answers:
        text += f"It was asked for {things}; without labels nothing is scored."
    else:
        text += "Nothing was asked of it."
    unknown = sum(row["note"].startswith(NOT_UNDERSTOOD) for row in answers)
    parts = {
        _count(len(scenes), "scene"): True,
        f"[{left_out} left out](#left-out)": left_out,
        f"{scored} scored quer{'y' if scored == 1 else 'ies'}": answers,
        f"{len(answers) - scored} asked without truth": len(answers) > scored,
        f"{unknown} not understood (IoU 0)": unknown,
    }
    counted = ", ".join(part for part, holds in parts.items() if holds)
    blocks: list[Block] = [Prose(text, "lead"), Prose(f"{counted}.", "soft fine")]
    numbers = key_numbers(scenes, scores, next(iter(methods), ""))
    terms = {title: TERMS[title] for title in (*numbers, QUERY, BUILD, RANGE)}
    blocks += [Numbers(numbers, COSTS), Fold("What these numbers mean", [Terms(terms)])]
    return blocks


def _count(count: int, unit: str) -> str:
    return f"{count} {unit}{'' if count == 1 else 's'}"


def key_numbers(
    scenes: Sequence[Scene], scores: Sequence[Row], ours: str
) -> dict[str, list[tuple[str, str, str, str]]]:
    """Return the scores of answers and new views in each of the first data sets.

    ``scores`` are those of the first protocol. Our method is listed with the best other method that
    is not a variant of it.
    """
    numbers: dict[str, list[tuple[str, str, str, str]]] = {}
    sets = list(dict.fromkeys(scene.dataset for scene in scenes))
    for dataset in sets[:LOOKS]:
        name = dataset if len(sets) > 1 else ""
        for (metric, form, factor), title in zip(SCORES, TERMS, strict=False):
            by_method = {
                score["method"]: score
                for score in scores
                if (score["metric"], score["dataset"]) == (metric, dataset)
            }
            score = by_method.pop(ours, None)
            if score is None:
                continue
            interval = rival = ""
            if score["low"] is not None:
                low, high = (form.format(factor * score[end]) for end in ("low", "high"))
                interval = f"{low.removesuffix(' %')} to {high}"
            rivals = [by_method[method] for method in by_method if not is_variant(method)]
            if rivals:
                best = max(rivals, key=lambda rival: rival["value"])
                rival = f"best other: {form.format(factor * best['value'])}, {best['method']}"
            value = form.format(factor * score["value"])
            numbers.setdefault(title, []).append((name, value, interval, rival))
        psnr = [s.metrics["psnr"] for s in scenes if s.dataset == dataset and "psnr" in s.metrics]
        if psnr:
            numbers.setdefault(VIEW, []).append((name, f"{float(np.mean(psnr)):.1f} dB", "", ""))
    return numbers


def cost_numbers(costs: Sequence[Cost]) -> Numbers:
    """Return the speed of our method on each of the first data sets.

    The first method of ``costs`` for each data set is ours.
    """
    ours = {cost.dataset: cost for cost in reversed(costs)}
    names = list(dict.fromkeys(cost.dataset for cost in costs))
    numbers: dict[str, list[tuple[str, str, str, str]]] = {QUERY: [], BUILD: []}
    for dataset in names[:LOOKS]:
        name = dataset if len(names) > 1 else ""
        for title, seconds in ((QUERY, ours[dataset].view_query), (BUILD, ours[dataset].build)):
            if seconds is not None:
                text = f"{seconds:,.0f} s" if seconds >= 10 else f"{seconds:.2g} s"
                numbers[title].append((name, text, "", ""))
    return Numbers({title: lines for title, lines in numbers.items() if lines})
