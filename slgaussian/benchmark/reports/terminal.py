"""Scores as tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.reports.model import count_text, plain
from slgaussian.benchmark.reports.score_tables import conditions, method_tables, metrics_table
from slgaussian.benchmark.scores import Rows, score_table


def scenes_text(results: Sequence[SceneResult]) -> str:
    """Tabulate the first method's scores of each scene by data set, and all methods if several."""
    blocks = []
    for dataset in dict.fromkeys(result.dataset for result in results):
        members = [result for result in results if result.dataset == dataset]
        first = [result for result in members if result.method == members[0].method]
        rows = Rows.join(result.rows for result in members).leading
        scores = score_table(rows.where(method=first[0].method)).to_pylist()
        text = metrics_table({r.scene: r.scene_metrics for r in first}, scores).as_text()
        blocks.append(f"{text}\n{_conditions_text(scores[0])}" if scores else text)
        if rows and len(first) < len(members):
            blocks.append(methods_text(rows))
    return "\n\n".join(blocks)


def methods_text(samples: Rows) -> str:
    """Tabulate samples: one table per data set and protocol, one line per method."""
    tables = method_tables(samples)
    texts = ("\n".join([t.title, t.as_text(), *map(plain, t.notes)]) for t in tables)
    return "\n\n".join(texts)


def _conditions_text(score: Mapping[str, Any]) -> str:
    of = " of ".join(count_text(score[f"{unit}s"], unit) for unit in ("sample", "scene"))
    note = f"; {score['note']}" if score["note"] else ""
    return f"by {score['protocol']} ({conditions(score)}); {of}{note}"
