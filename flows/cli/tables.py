"""Tables of scores and versions as text for a terminal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from flows.cli.text import aligned
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.score_tables import MAIN, MORE, Table, conditions, method_tables
from slgaussian.benchmark.scores import score_table
from slgaussian.benchmark.statistics import LEVEL
from slgaussian.benchmark.summary import METRICS
from slgaussian.benchmark.verdict import clip_scores, verdict
from slgaussian.semantic.versions import Change, Version, called


def scores_tables(results: Sequence[SceneResult]) -> str:
    """A table of scenes for each data set, by the first method, and one of methods if there are
    others."""
    tables = []
    for dataset in dict.fromkeys(result.dataset for result in results):
        own = [result for result in results if result.dataset == dataset]
        leading = own[0].method
        tables.append(_scenes_table([result for result in own if result.method == leading]))
        scores = _leading_scores(own)
        if scores and any(result.method != leading for result in own):
            tables.append(_methods_table(dataset, scores))
    return "\n\n".join(tables)


def _methods_table(dataset: str, scores: Sequence[Mapping[str, Any]]) -> str:
    """One line a method: the means of its scores over scenes, by the leading protocol.

    The first score has its interval; all of them are in the report. Below is what they go by.
    """
    titles = {m.key: m for m in METRICS if any(s["metric"] == m.key for s in scores)}
    first, *others = (m.title for m in titles.values())
    rows = [[dataset, first, f"{100 * LEVEL:.0f} %", *others]]
    for method in dict.fromkeys(score["method"] for score in scores):
        own = {s["metric"]: s for s in scores if s["method"] == method}
        value, *rest = (_number(own[key]["value"], m.digits) for key, m in titles.items())
        (key, m), *_ = titles.items()
        rows.append([method, value, _interval(own[key], m.digits), *rest])
    return f"{aligned(rows)}\n{_by_what(scores[0])}"


def _scenes_table(results: Sequence[SceneResult]) -> str:
    """One line a scene, their mean and its interval; a dash where a scene has not the number.

    The mean is over the scenes that have the number, each counting once. Below is said what the
    scores of answers go by; the other numbers go by no protocol and have no interval.
    """
    shown = [m for m in METRICS if any(m.key in r.scene_metrics for r in results)]
    rows = [["scene", *(m.title for m in shown)]]
    for result in results:
        numbers = (_number(result.scene_metrics.get(m.key), m.digits) for m in shown)
        rows.append([result.scene, *numbers])
    means = []
    for m in shown:
        values = [r.scene_metrics[m.key] for r in results if m.key in r.scene_metrics]
        means.append(_number(sum(values) / len(values), m.digits))
    rows.append(["mean", *means])
    scores = _leading_scores(results)
    if not scores:
        return aligned(rows)
    known = {row["metric"]: row for row in scores}
    rows.append([f"{100 * LEVEL:.0f} %", *(_interval(known.get(m.key), m.digits) for m in shown)])
    return f"{aligned(rows)}\n{_by_what(scores[0])}"


def _leading_scores(results: Sequence[SceneResult]) -> list[dict[str, Any]]:
    """Scores by the protocol whose numbers the scenes' metrics are, that of the first row."""
    rows = [row for result in results for row in result.rows]
    own = [row for row in rows if row["protocol"] == rows[0]["protocol"]]
    return score_table(own).to_pylist()


def _by_what(score: Mapping[str, Any]) -> str:
    counts = ((score[f"{what}s"], what) for what in ("sample", "scene"))
    of = " of ".join(f"{n} {what}" if n == 1 else f"{n} {what}s" for n, what in counts)
    note = f"; {score['note']}" if score["note"] else ""
    return f"by {score['protocol']} ({conditions(score)}); {of}{note}"


def _interval(score: Mapping[str, Any] | None, digits: int) -> str:
    if score is None or score["low"] is None:
        return "-"
    return f"{score['low']:.{digits}f}-{score['high']:.{digits}f}"


SHOWN_GAINS = ("IoU", "mIoU", "Point in mask", "AP")
"""Scores that a terminal has room for."""


def gains_table(table: Table) -> str:
    """One line a pair of methods or runs: some differences, each with its interval."""
    shown = [k for k, column in enumerate(table.columns) if column.title in SHOWN_GAINS]
    shown = [k for k in shown if table.columns[k].protocol in ("slgaussian", "threshold-free")]
    rows = [[table.dataset, *(table.columns[k].title for k in shown)]]
    for line in table.lines:
        cells = (line.cells[k] for k in shown)
        told = (f"{c.value} ({c.interval})" if c.interval else c.value for c in cells)
        rows.append([line.method, *told])
    return aligned(rows)


def masks_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table a data set and protocol of samples, one line a method: each score and its interval.

    Below is what the scores go by.
    """
    tables = []
    for table in method_tables(score_table(rows).to_pylist(), (*MAIN, *MORE)):
        start = 0
        for group in table.groups:
            end = start + len(group.columns)
            lines = [[table.dataset, *(column.title for column in group.columns)]]
            for line in table.lines:
                cells = line.cells[start:end]
                told = (f"{c.value} ({c.interval})" if c.interval else c.value for c in cells)
                lines.append([line.method, *told])
            notes = [cell.note for line in table.lines for cell in line.cells[start:end]]
            of = f"{table.scenes} scene" + ("s" if table.scenes > 1 else "")
            said = [group.counts[0], of, *dict.fromkeys(filter(None, notes))]
            by = f"by {group.protocol} ({group.conditions}); {'; '.join(said)}"
            tables.append(f"{aligned(lines)}\n{by}")
            start = end
    return "\n\n".join(tables)


def judgements_table(judgements: pa.Table) -> str:
    """Mean IoU of each lifting, and whether the branch is better than none, and than before."""
    kinds = list(dict.fromkeys(judgements["labels"].to_pylist()))
    scores = {kind: clip_scores(judgements, kind) for kind in kinds}
    rows = [["lifting", *(f"IoU, labels {kind}" for kind in kinds)]]
    for name in dict.fromkeys(judgements["lifting"].to_pylist()):
        rows.append([name, *(f"{np.mean(scores[kind][name]):.4f}" for kind in kinds)])
    others = [name for name, *_ in rows[1:] if name in ("hard", "filled", "before")]
    lines = [verdict(judgements, other, other).why for other in others]
    return "\n".join([aligned(rows), *lines])


def versions_table(
    versions: Collection[Version], current: Version | None, history: Sequence[Change]
) -> str:
    """One line a version and what its gate said, the one in use marked; and since when it is."""
    rows = [["version", "from", "made", "weights", "gate", ""]]
    for version in versions:
        mark = " *" if version == current else ""
        facts = [str(version.parent or "-"), version.made, version.digest[:12]]
        gate = "passed" if version.promoted else "held"
        rows.append([f"{version.number}{mark}", *facts, gate, version.why])
    lines = aligned(rows, "<>>>><")
    used = "none is in use" if current is None else f"* in use: version {current.number}"
    return f"{lines}\n{used}, {_changed(history[-1])}" if history else f"{lines}\n{used}"


def history_lines(history: Sequence[Change]) -> list[str]:
    """A line for each change of the version in use, the oldest first."""
    return [f"{called(change.version)} in use {_changed(change)}" for change in history]


def _changed(change: Change) -> str:
    why = f": {change.why}" if change.why else ""
    return f"since {change.when} instead of {called(change.before)}, by {change.by}{why}"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
