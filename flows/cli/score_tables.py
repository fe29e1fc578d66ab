"""Scores as tables for a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from flows.cli.tables import table_text
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.score_tables import MAIN, MORE, Cell, Table, conditions, method_tables
from slgaussian.benchmark.scores import score_table
from slgaussian.benchmark.statistics import LEVEL
from slgaussian.benchmark.summary import summarize

GAINS = ("IoU", "mIoU", "Point in mask", "AP")
"""Differences that a terminal has room for."""


def scenes_text(results: Sequence[SceneResult]) -> str:
    """Tabulate the scenes of each data set, by the first method, and the methods if several."""
    blocks = []
    for dataset in dict.fromkeys(result.dataset for result in results):
        members = [result for result in results if result.dataset == dataset]
        first = [result for result in members if result.method == members[0].method]
        blocks.append(_scenes_block(first))
        if len(first) < len(members):
            blocks += _method_blocks(_leading_rows(members))
    return "\n\n".join(blocks)


def _scenes_block(results: Sequence[SceneResult]) -> str:
    """Tabulate the scenes of a data set: a line each, their mean and its interval.

    The mean is over the scenes that have the number, each counting once. Below is what the scores
    of answers go by; the other numbers go by no protocol and have no interval.
    """
    summary = summarize([result.scene_metrics for result in results])
    rows: list[Sequence[str]] = [["scene", *(metric.title for metric in summary.columns)]]
    rows += [[r.scene, *line] for r, line in zip(results, summary.lines, strict=True)]
    rows.append(["mean", *summary.means])
    scores = score_table(_leading_rows(results)).to_pylist()
    if not scores:
        return table_text(rows)
    by_metric = {score["metric"]: score for score in scores}
    intervals = (_interval(by_metric.get(m.key), m.digits) for m in summary.columns)
    rows.append([f"{100 * LEVEL:.0f} %", *intervals])
    score = scores[0]
    counts = ((score[f"{unit}s"], unit) for unit in ("sample", "scene"))
    of = " of ".join(f"{n} {unit}" if n == 1 else f"{n} {unit}s" for n, unit in counts)
    note = f"; {score['note']}" if score["note"] else ""
    return f"{table_text(rows)}\nby {score['protocol']} ({conditions(score)}); {of}{note}"


def _leading_rows(results: Sequence[SceneResult]) -> list[dict[str, Any]]:
    """Return the samples by the protocol of the first, whose numbers the scenes' metrics are."""
    rows = [row for result in results for row in result.rows]
    return [row for row in rows if row["protocol"] == rows[0]["protocol"]]


def _interval(score: Mapping[str, Any] | None, digits: int) -> str:
    if score is None or score["low"] is None:
        return "–"
    return f"{score['low']:.{digits}f}-{score['high']:.{digits}f}"


def methods_text(samples: Sequence[Mapping[str, Any]]) -> str:
    """Tabulate samples: a table a data set and protocol, one line a method."""
    return "\n\n".join(_method_blocks(samples))


def _method_blocks(samples: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the tables of samples, each score with its interval; below is what they go by."""
    for table in method_tables(score_table(samples).to_pylist(), (*MAIN, *MORE)):
        start = 0
        for group in table.groups:
            end = start + len(group.columns)
            rows = [[table.dataset, *(column.title for column in group.columns)]]
            rows += [[line.method, *map(_text, line.cells[start:end])] for line in table.lines]
            notes = [cell.note for line in table.lines for cell in line.cells[start:end]]
            scenes = f"{table.scenes} scene" + ("s" if table.scenes > 1 else "")
            facts = [group.counts[0], scenes, *dict.fromkeys(filter(None, notes))]
            by = f"by {group.protocol} ({group.conditions}); {'; '.join(facts)}"
            yield f"{table_text(rows)}\n{by}"
            start = end


def gains_text(table: Table) -> str:
    """Tabulate pairs of methods or runs: some differences, each with its interval."""
    shown = [
        k
        for k, column in enumerate(table.columns)
        if column.title in GAINS and column.protocol in ("slgaussian", "threshold-free")
    ]
    rows = [[table.dataset, *(table.columns[k].title for k in shown)]]
    rows += [[line.method, *(_text(line.cells[k]) for k in shown)] for line in table.lines]
    return table_text(rows)


def _text(cell: Cell) -> str:
    return f"{cell.value} ({cell.interval})" if cell.interval else cell.value
