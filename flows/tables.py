"""Scores as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.report import METRICS


def scores_table(results: Sequence[SceneResult]) -> str:
    """One line a scene and their mean; a dash where a scene has no truth for the number.

    The mean is over the scenes that have the number, each counting once.
    """
    shown = [m for m in METRICS if any(m.key in r.scene_metrics for r in results)]
    rows = [["scene", *(m.title for m in shown)]]
    for result in results:
        values = (result.scene_metrics.get(m.key) for m in shown)
        rows.append([result.scene, *map(_number, values, (m.digits for m in shown))])
    means = []
    for m in shown:
        values = [r.scene_metrics[m.key] for r in results if m.key in r.scene_metrics]
        means.append(_number(sum(values) / len(values), m.digits))
    rows.append(["mean", *means])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for name, *cells in rows:
        aligned = (cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True))
        lines.append("  ".join([name.ljust(widths[0]), *aligned]))
    return "\n".join(lines)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
