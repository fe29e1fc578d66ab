"""Methods of several runs ranked: a table for each data set, protocol, size and list of questions.

Only what was asked the same is in one table: the same queries of the same frames of the same
scenes, with the same truth where the manifests know it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slgaussian.benchmark.comparison import Made
from slgaussian.benchmark.rendering import template
from slgaussian.benchmark.score_tables import MAIN, MORE, Column
from slgaussian.benchmark.scores import METRICS, score_table
from slgaussian.errors import InputError

ORDER = tuple(dict.fromkeys(column.protocol for column in (*MAIN, *MORE)))


@dataclass(frozen=True)
class Ranking:
    """A table of methods, best first; cells are text, and the first column is the rank."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class _Entry:
    made: Made
    method: str
    asked: frozenset[tuple[str, str, str]]
    truth: Mapping[str, str]
    scores: Mapping[str, Mapping[str, Any]]
    seconds: float | None


def rank_methods(runs: Sequence[Made]) -> list[Ranking]:
    """Rank the methods of runs by the first score of each protocol; equal as printed is equal.

    Raises
    ------
    InputError
        If a run is given twice, or has no scored sample.
    """
    tables: dict[tuple[str, str, str], list[list[_Entry]]] = {}
    for number, made in enumerate(runs):
        if made.folder.resolve() in [other.folder.resolve() for other in runs[:number]]:
            raise InputError(f"compare: {made.folder} is given twice; give each folder once")
        entries = _entries(made)
        if not entries:
            raise InputError(
                f"{made.folder}: found no scored sample, expected what benchmark or score wrote "
                "with labels; leave this folder out"
            )
        for kind, entry in entries:
            groups = tables.setdefault(kind, [])
            same = next((group for group in groups if _same(group[0], entry)), None)
            if same is None:
                groups.append([entry])
            else:
                same.append(entry)
    ordered = sorted(tables, key=lambda kind: ORDER.index(kind[1].partition("@")[0]))
    return [
        _ranking(kind, group)
        for kind in ordered
        for group in sorted(tables[kind], key=len, reverse=True)
    ]


def render_ranking(
    rankings: Sequence[Ranking], differences: Mapping[str, Sequence[tuple[str, str, str]]]
) -> tuple[str, str]:
    """Render rankings, and what differs from the first run by folder, as HTML and as Markdown."""
    shown = {"rankings": rankings, "differences": differences}
    page, markdown = (template(f"ranking.{kind}.j2").render(**shown) for kind in ("html", "md"))
    return page, markdown


def _entries(made: Made) -> list[tuple[tuple[str, str, str], _Entry]]:
    seconds = {(cost.dataset, cost.method): cost.view_query for cost in made.costs}
    data = made.manifest.get("data", {})
    entries = []
    for method, rows in made.by_method.items():
        kinds: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
        for row in rows:
            size = f"{row['height']} x {row['width']}"
            kinds.setdefault((row["dataset"], row["protocol"], size), []).append(row)
        for kind, own in kinds.items():
            scores = {score["metric"]: score for score in score_table(own).to_pylist()}
            if not any(column.metric in scores for column in _columns(kind[1])):
                continue
            scored = [row for row in own if any(m.of(row) is not None for m in METRICS)]
            asked = frozenset((row["scene"], row["frame"], row["query"]) for row in scored)
            known = {scene: data.get(scene, {}).get("truth") for scene, *_ in asked}
            truth = {scene: digest for scene, digest in known.items() if digest is not None}
            spent = seconds.get((kind[0], method))
            entries.append((kind, _Entry(made, method, asked, truth, scores, spent)))
    return entries


def _columns(protocol: str) -> list[Column]:
    """List the scores of a protocol that are the better the greater."""
    name = protocol.partition("@")[0]
    return [column for column in (*MAIN, *MORE) if column.protocol == name and column.sign > 0]


def _same(one: _Entry, other: _Entry) -> bool:
    shared = one.truth.keys() & other.truth.keys()
    return one.asked == other.asked and all(one.truth[s] == other.truth[s] for s in shared)


def _ranking(kind: tuple[str, str, str], group: Sequence[_Entry]) -> Ranking:
    columns = [c for c in _columns(kind[1]) if any(c.metric in e.scores for e in group)]
    first = columns[0]

    def value(entry: _Entry) -> float:
        score = entry.scores.get(first.metric)
        return -1.0 if score is None else round(score["value"], first.digits)

    rows = []
    for entry in sorted(group, key=value, reverse=True):
        rank = 1 + sum(value(other) > value(entry) for other in group)
        seconds = "–" if entry.seconds is None else f"{entry.seconds:.3f}"
        cells = [_cell(entry.scores.get(column.metric), column.digits) for column in columns]
        rows.append((str(rank), entry.method, str(entry.made.folder), *cells, seconds))
    scenes = len({scene for scene, *_ in group[0].asked})
    dataset, protocol, size = kind
    return Ranking(
        f"{dataset} by {protocol} at {size}: {scenes} scenes, {len(group[0].asked)} queries",
        ("#", "method", "run", *(column.title for column in columns), "s"),
        tuple(rows),
    )


def _cell(score: Mapping[str, Any] | None, digits: int) -> str:
    if score is None:
        return "–"
    low, high = score["low"], score["high"]
    interval = "" if low is None else f" ({low:.{digits}f}–{high:.{digits}f})"
    return f"{score['value']:.{digits}f}{interval}"
