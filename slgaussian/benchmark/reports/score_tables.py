"""Tables of scores with their confidence intervals and evaluation settings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian.benchmark.reports import model
from slgaussian.benchmark.scores import Difference, Rows, differences, group_rows, score_table
from slgaussian.benchmark.statistics import CONFIDENCE_LEVEL, MIN_SAMPLES, Comparison

if TYPE_CHECKING:  # a comparison of runs needs no evaluation
    from slgaussian.benchmark.evaluate import SceneResult

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Score:
    """A metric in a table: its name in the data, title, number of digits and description."""

    metric: str
    title: str
    digits: int
    help: str

    @property
    def column(self) -> model.Column:
        """Return the column of the score in a table."""
        return model.Column(self.title, self.help)


IOU = Score("iou", "IoU", 3, "intersection over union of predicted and labelled mask")
BOUNDARY_IOU = Score("boundary_iou", "Boundary IoU", 3, "IoU of the masks' boundary regions")
MIOU = Score("miou", "mIoU", 3, "mean class IoU; all queries compete for each pixel")
HIT_MASK = Score("hit_mask", "Point in mask", 2, "share of predicted points in the labelled mask")
HIT_BOX = Score("hit_box", "Point in box", 2, "share of predicted points in the labelled box")
HIT_PEAK = Score("hit_peak", "Peak in box", 2, "share of queries with a relevancy peak in the box")

SCORES = {
    "slgaussian": (IOU, MIOU, HIT_MASK, HIT_BOX, BOUNDARY_IOU),
    "langsplat": (IOU, BOUNDARY_IOU, HIT_PEAK, HIT_BOX),
    "highest-pixel": (HIT_BOX, HIT_PEAK),
    "langsplat-rescaled": (IOU, HIT_BOX),
    "3d-ovs": (MIOU, Score("accuracy", "Accuracy", 3, "share of pixels with the correct class")),
}
"""Scores by protocol (without version), in the order of tables and columns; the first score of a
protocol ranks the methods."""

METRICS = (
    IOU,
    HIT_MASK,
    HIT_BOX,
    HIT_PEAK,
    MIOU,
    Score("psnr", "PSNR", 1, "of rendered held-out views, dB"),
    Score("ssim", "SSIM", 3, "of rendered held-out views"),
    Score("abs_rel", "Depth abs-rel ↓", 3, "relative depth error in the context views"),
    Score("delta125", "δ < 1.25", 3, "share of pixels whose depth is within 25 %"),
    Score("bad2", "bad-2.0 ↓", 3, "share of pixels with a disparity error above 2 px"),
    Score("target_abs_rel", "Novel abs-rel ↓", 3, "depth error in rendered held-out views"),
)
"""Metrics of a scene by its first protocol, and of its views; ↓: lower is better."""


def protocol_scores(protocol: str) -> tuple[Score, ...]:
    """Return the scores of a protocol, given as ``name`` or ``name@version``."""
    return SCORES[protocol.partition("@")[0]]


def method_tables(samples: Rows, ours: str = "") -> list[model.Table]:
    """Return a table for each data set and protocol: a row per method, best first.

    Scores that no method has are left out. Notes name the methods with other settings than most.
    With a single method nothing is marked as best. The last column is the difference of the method
    ``ours`` to each other method in the first score.
    """
    order = list(SCORES)
    groups = group_rows(score_table(samples).to_pylist(), "dataset", "protocol")
    gains = _gains(samples, ours)
    tables = []
    for (dataset, protocol), rows in sorted(
        groups.items(), key=lambda item: order.index(item[0][1].partition("@")[0])
    ):
        by_method = {
            method: {row["metric"]: row for row in method_rows}
            for (method,), method_rows in group_rows(rows, "method").items()
        }
        columns = _present(protocol, by_method)
        if not columns:
            continue
        best = [
            max((r[s.metric] for r in by_method.values() if s.metric in r), key=itemgetter("value"))
            for s in columns
        ]
        lines: list[list[Any]] = []
        for method, by_metric in by_method.items():
            cells = [score_cell(by_metric.get(score.metric), score.digits) for score in columns]
            for place, (score, highest) in enumerate(zip(columns, best, strict=True)):
                is_best = cells[place].value == f"{highest['value']:.{score.digits}f}"
                if is_best and len(by_method) > 1:
                    cells[place] = replace(cells[place], mark="best")
            if ours:
                gain = gains.get((dataset, protocol, method, columns[0].metric))
                cells.append(gain_cell(gain, columns[0]))
            queries = max(row["samples"] for row in by_metric.values())
            lines.append([model.Cell(method), *cells, str(queries)])
        lines.sort(key=lambda line: line[1].value.replace(model.NO_VALUE, ""), reverse=True)
        heads = ["Method", *(score.column for score in columns)]
        if ours:
            text = f"difference in {columns[0].title} on common queries, paired by scene"
            heads.append(model.Column(f"{ours} minus method", text))
        settings = {method: conditions(next(iter(r.values()))) for method, r in by_method.items()}
        ((usual, _),) = Counter(settings.values()).most_common(1)
        scenes, places = (max(row[unit] for row in rows) for unit in ("scenes", "places"))
        notes = [
            f"{model.escape(protocol)}: {model.escape(usual)}.",
            *(f"{model.escape(m)}: {model.escape(s)}." for m, s in settings.items() if s != usual),
            f"Mean over {model.count_text(scenes, 'scene')} of the scene means. "
            f"{_describe_interval(scenes, places)}",
        ]
        title = f"{dataset}, protocol {protocol}"
        tables.append(model.Table([*heads, "Queries"], lines, title, notes))
    return tables


def _present(protocol: str, by_name: Mapping[str, Mapping[str, Any]]) -> list[Score]:
    """Return the scores of a protocol that any of several mappings by metric has."""
    return [s for s in protocol_scores(protocol) if any(s.metric in of for of in by_name.values())]


def _gains(samples: Rows, ours: str) -> dict[tuple[str, ...], Difference]:
    """Return our differences to each other method by data set, protocol, method and metric."""
    return {
        (gain.dataset, gain.protocol, method, gain.metric): gain
        for method in samples.values("method")
        if ours and method != ours
        for gain in differences(samples.where(method=ours), samples.where(method=method))
    }


def fold_protocols(
    tables: Sequence[model.Table], explanations: Sequence[model.Block] = ()
) -> list[model.Block]:
    """Return the tables of the first protocol, explanations, and the other tables collapsed."""
    protocol = tables[0].title.rpartition(", ")[2]
    first = [table for table in tables if table.title.endswith(f", {protocol}")]
    rest = [table for table in tables if table not in first]
    return [*first, *explanations, *([model.Fold("Other protocols", rest)] if rest else [])]


def difference_tables(compared: Mapping[str, Sequence[Difference]]) -> list[model.Table]:
    """Return a table for each data set and protocol: a row for each name, its differences."""
    groups: dict[tuple[str, str], dict[str, dict[str, Difference]]] = {}
    for name, found in compared.items():
        for difference in found:
            by_name = groups.setdefault((difference.dataset, difference.protocol), {})
            by_name.setdefault(name, {})[difference.metric] = difference
    tables = []
    for (dataset, protocol), by_name in groups.items():
        columns = _present(protocol, by_name)
        if not columns:
            continue
        lines = [
            [name, *(gain_cell(by_metric.get(score.metric), score) for score in columns)]
            for name, by_metric in by_name.items()
        ]
        gains = [d.gain for by_metric in by_name.values() for d in by_metric.values()]
        scenes, places = max(g.samples for g in gains), max(g.independent_samples for g in gains)
        note = f"Common queries of {model.count_text(scenes, 'scene')}. "
        note += _describe_interval(scenes, places)
        if places >= MIN_SAMPLES:
            note += " Green: significant gain; red: significant loss; not corrected for multiple "
            note += "comparisons (1 in 20 is significant by chance)."
        heads = ["Method", *(score.column for score in columns)]
        tables.append(model.Table(heads, lines, f"{dataset}, protocol {protocol}", [note]))
    return tables


def _describe_interval(scenes: int, places: int) -> str:
    """Describe the intervals of means over scenes; the scenes show a number of places."""
    if places == 1:
        return f"No interval for one {'scene' if scenes == 1 else 'place'}."
    unit = "scenes" if places == scenes else f"{places} places, and of scenes within each place"
    rough = f"; unreliable below {MIN_SAMPLES}" if places < MIN_SAMPLES else ""
    return f"Intervals: {CONFIDENCE_LEVEL:.0%} bootstrap over {unit}{rough}."


def metrics_table(
    metrics: Mapping[str, Mapping[str, float]],
    scores: Sequence[Row] = (),
    title: str = "",
    links: Mapping[str, str] | None = None,
) -> model.Table:
    """Return a table with a row per scene and a row of unweighted means over scenes.

    ``metrics`` are by scene and name. Metrics in ``scores``, rows of the spec ``scores``, have
    intervals. ``links`` are ids of parts of the page by scene.
    """
    columns = [m for m in METRICS if any(m.metric in values for values in metrics.values())]
    lines: list[list[Any]] = []
    for scene, values in metrics.items():
        numbers = (model.number(values.get(m.metric), m.digits) for m in columns)
        lines.append([model.Cell(scene, link=(links or {}).get(scene, "")), *numbers])
    lines.append(["mean", *mean_cells(metrics, scores, columns)])
    return model.Table(["Scene", *(m.column for m in columns)], lines, title, has_total=True)


def mean_cells(
    metrics: Mapping[str, Mapping[str, float]], scores: Sequence[Row], columns: Sequence[Score]
) -> list[model.Cell]:
    """Return the means of metrics over scenes; arguments as in :func:`metrics_table`."""
    by_metric = {score["metric"]: score for score in scores}
    cells = []
    for m in columns:
        values = [by_name[m.metric] for by_name in metrics.values() if m.metric in by_name]
        mean = f"{np.mean(values):.{m.digits}f}" if values else model.NO_VALUE
        cells.append(model.Cell(mean, score_cell(by_metric.get(m.metric), m.digits).below))
    return cells


def gain_cell(difference: Difference | None, score: Score) -> model.Cell:
    """Format a difference; one of a single place has no interval."""
    if difference is None:
        return model.Cell(model.NO_VALUE)
    cell = comparison_cell(difference.gain, score.digits)
    return cell if difference.gain.independent_samples > 1 else replace(cell, below="")


def comparison_cell(gain: Comparison, digits: int) -> model.Cell:
    """Format a gain with its interval and mark.

    It is significant if its printed interval excludes 0, with :data:`MIN_SAMPLES` places or more.
    """
    value, low, high = (
        round(bound, digits) + 0.0  # not -0.000
        for bound in (gain.difference, gain.low, gain.high)
    )
    mark = "better" if low > 0 else "worse" if high < 0 else "noise"
    if gain.independent_samples < 2 or (gain.independent_samples < MIN_SAMPLES and mark != "noise"):
        mark = "few"
    return model.Cell(f"{value:+.{digits}f}", f"{low:+.{digits}f} to {high:+.{digits}f}", mark)


def conditions(score: Row) -> str:
    """Describe the settings of a score, a row of the spec ``scores`` or ``samples``."""
    selection: str = score["selection"]
    parts = [{"none": "no mask", "given": "given masks"}.get(selection, selection)]
    for name in ("threshold", "share", "filter", "temperature"):
        if (value := score[name]) is not None:
            parts.append(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}")
    for title, name in (("phrases", "canonical"), ("absent", "absent")):
        if score[name] is not None:
            parts.append(f"{title}: {score[name]}")
    return ", ".join(parts)


def score_cell(row: Row | None, digits: int) -> model.Cell:
    """Format a score with its interval."""
    if row is None:
        return model.Cell(model.NO_VALUE)
    bounds = row["low"], row["high"]
    below = "" if None in bounds else "–".join(f"{bound:.{digits}f}" for bound in bounds)
    return model.Cell(f"{row['value']:.{digits}f}", below)


def scenes_text(results: Sequence[SceneResult]) -> str:
    """Tabulate the first method's scores of each scene by data set, and all methods if several."""
    blocks = []
    for dataset in dict.fromkeys(result.dataset for result in results):
        members = [result for result in results if result.dataset == dataset]
        first = [result for result in members if result.method == members[0].method]
        rows = Rows.join(result.rows for result in members).leading
        scores = score_table(rows.where(method=first[0].method)).to_pylist()
        text = metrics_table({r.scene: r.scene_metrics for r in first}, scores).as_text()
        if scores:
            counts = [model.count_text(scores[0][f"{unit}s"], unit) for unit in ("sample", "scene")]
            note = f"; {scores[0]['note']}" if scores[0]["note"] else ""
            text += f"\nby {scores[0]['protocol']} ({conditions(scores[0])}); "
            text += " of ".join(counts) + note
        blocks.append(text)
        if rows and len(first) < len(members):
            blocks.append(methods_text(rows))
    return "\n\n".join(blocks)


def methods_text(samples: Rows) -> str:
    """Tabulate samples: one table per data set and protocol, one line per method."""
    tables = method_tables(samples)
    texts = ("\n".join([t.title, t.as_text(), *map(model.plain, t.notes)]) for t in tables)
    return "\n\n".join(texts)
