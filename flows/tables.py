"""Scores as text for a terminal."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.report import METRICS
from slgaussian.semantic.verdict import clip_scores, verdict
from slgaussian.versions import Version


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
    return _aligned(rows)


def judgements_table(judgements: pa.Table) -> str:
    """Mean IoU of each lifting, and whether the branch is better than none, and than before."""
    kinds = list(dict.fromkeys(judgements["labels"].to_pylist()))
    scores = {kind: clip_scores(judgements, kind) for kind in kinds}
    rows = [["lifting", *(f"IoU, labels {kind}" for kind in kinds)]]
    for name in dict.fromkeys(judgements["lifting"].to_pylist()):
        rows.append([name, *(f"{np.mean(scores[kind][name]):.4f}" for kind in kinds)])
    others = [name for name, *_ in rows[1:] if name in ("hard", "before")]
    lines = [verdict(judgements, other, other).why for other in others]
    return "\n".join([_aligned(rows), *lines])


def versions_table(versions: Collection[Version], current: Version | None) -> str:
    """One line a version, the one in use marked, and why it was put to use or not."""
    rows = [["version", "from", "made", "weights"]]
    for version in versions:
        mark = " *" if version == current else ""
        parent = str(version.parent or "-")
        rows.append([f"{version.number}{mark}", parent, version.made, version.digest[:12]])
    lines = _aligned(rows).splitlines()
    whys = ["", *(f"  {'' if v.promoted else 'not used: '}{v.why}" for v in versions)]
    told = [line + why for line, why in zip(lines, whys, strict=True)]
    return "\n".join([*told, "* in use" if current is not None else "none is in use"])


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for name, *cells in rows:
        aligned = (cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True))
        lines.append("  ".join([name.ljust(widths[0]), *aligned]))
    return "\n".join(lines)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
