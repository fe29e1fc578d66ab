"""Tables of scores with their intervals and conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.reports.model import (
    NO_VALUE,
    Cell,
    Column,
    Line,
    Table,
    escape,
    line_of,
    number,
)
from slgaussian.benchmark.scores import Difference, differences, grouped
from slgaussian.benchmark.statistics import LEAST, LEVEL, Comparison

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Score:
    """A score: its protocol without version, its name there, and its format.

    ``sign`` is -1 if lower is better.
    """

    protocol: str
    metric: str
    title: str
    digits: int
    help: str
    sign: int = 1

    @property
    def column(self) -> Column:
        """Return the column of the score in a table."""
        return Column(self.title + (" ↓" if self.sign < 0 else ""), self.help)


SCORES = (
    Score("slgaussian", "iou", "IoU", 3, "mask against label"),
    Score("slgaussian", "miou", "mIoU", 3, "all texts compete for each pixel"),
    Score("slgaussian", "hit_mask", "Point in mask", 2, "one point lies on the object"),
    Score("slgaussian", "hit_box", "Point in box", 2, "the same, in its box"),
    Score("slgaussian", "boundary_iou", "Boundary IoU", 3, "their rims"),
    Score("langsplat", "iou", "IoU", 3, "smoothed, stretched relevancy above 0.4"),
    Score("langsplat", "boundary_iou", "Boundary IoU", 3, "their rims"),
    Score("langsplat", "hit_peak", "Peak in box", 2, "any of the most relevant pixels"),
    Score("langsplat", "hit_box", "Point in box", 2, "the middle one of them"),
    Score("highest-pixel", "hit_box", "Pixel in box", 2, "the first of the most relevant pixels"),
    Score("highest-pixel", "hit_peak", "Pixels in box", 2, "any of them"),
    Score("langsplat-rescaled", "iou", "IoU", 3, "the same, filter scaled to the image"),
    Score("langsplat-rescaled", "hit_box", "Point in box", 2, "the same"),
    Score("3d-ovs", "miou", "mIoU", 3, "all texts compete for each pixel"),
    Score("3d-ovs", "accuracy", "Accuracy", 3, "pixels with the right class and no other"),
)
"""Scores in the order of tables and columns; the first score of a protocol ranks the methods."""

SELECTIONS = {"none": "no mask", "given": "masks as given"}
"""Descriptions of some selections in place of their names."""

VERDICTS = {
    "better": "ahead",
    "worse": "behind",
    "noise": "no difference beyond noise",
    "few": "too few places to tell",
}
"""Words by the mark of a difference, see :func:`gain_cell`."""


METRICS = (
    Score("", "iou", "IoU", 3, "mean over queries of one mask each against the labelled mask"),
    Score("", "hit_mask", "Point in mask", 2, "share of queries whose point lies on the object"),
    Score("", "hit_box", "Point in box", 2, "the same against the object's box, as LERF counts"),
    Score("", "hit_peak", "Peak in box", 2, "any of the most relevant pixels, as LangSplat counts"),
    Score("", "miou", "mIoU", 3, "all queries compete for each pixel; mean class IoU, whole image"),
    Score("", "psnr", "PSNR", 1, "dB, rendered novel view against the photograph"),
    Score("", "ssim", "SSIM", 3, "rendered novel view against the photograph"),
    Score("", "abs_rel", "Depth abs-rel", 3, "context views, all pixels with true depth", -1),
    Score("", "delta125", "δ < 1.25", 3, "share of pixels whose depth is within 25 %"),
    Score("", "bad2", "bad-2.0", 3, "rectified pairs: share of pixels over 2 px off", -1),
    Score("", "target_abs_rel", "Novel abs-rel", 3, "depth rendered at the novel view", -1),
)
"""Metrics of a scene by its first protocol, and of its views; they have no protocol here."""


def scores_of(protocol: str) -> list[Score]:
    """Return the scores of a protocol, given as ``name`` or ``name@version``."""
    return [score for score in SCORES if score.protocol == protocol.partition("@")[0]]


def method_tables(
    scores: Sequence[Row], gains: Mapping[tuple[str, str], Difference] | None = None, ours: str = ""
) -> list[Table]:
    """Return a table for each data set and protocol: a line per method, best first.

    Scores that no method has are left out. A method with other conditions or another number of
    samples than most is marked. With a single method nothing is marked as best.

    Parameters
    ----------
    scores : rows of the spec ``scores``
    gains : {(data set, method): Difference}, optional
        Difference of ``ours`` to the method in the first score, for the last column.
    ours : str
        The method whose line is highlighted.
    """
    order = list(dict.fromkeys(score.protocol for score in SCORES))
    tables = []
    groups = grouped(scores, "dataset", "protocol")
    for (dataset, protocol), rows in sorted(
        groups.items(), key=lambda item: order.index(item[0][1].partition("@")[0])
    ):
        by_method = {
            method: {row["metric"]: row for row in method_rows}
            for (method,), method_rows in grouped(rows, "method").items()
        }
        columns = [s for s in scores_of(protocol) if any(s.metric in r for r in by_method.values())]
        if not columns:
            continue
        usual = _commonest(conditions(row) for row in rows).split(", ")
        counts, best = {}, {}
        for score in columns:
            present = [r[score.metric] for r in by_method.values() if score.metric in r]
            counts[score] = _commonest(row["samples"] for row in present)
            best[score] = max(score.sign * round(row["value"], score.digits) for row in present)
        lines = []
        for method, by_metric in by_method.items():
            cells = [Cell(method)]
            for score in columns:
                row = by_metric.get(score.metric)
                cell = score_cell(row, score.digits)
                if row is not None:
                    is_best = score.sign * round(row["value"], score.digits) == best[score]
                    samples = f"n {row['samples']}" if row["samples"] != counts[score] else ""
                    note = "; ".join(filter(None, (row["note"], samples)))
                    cell = replace(
                        cell, mark="best" if is_best and len(by_method) > 1 else "", note=note
                    )
                cells.append(cell)
            if gains:
                cells.append(gain_cell(gains.get((dataset, method)), columns[0], is_worded=True))
            unusual = dict.fromkeys(
                part
                for row in by_metric.values()
                for part in conditions(row).split(", ")
                if part not in usual
            )
            text = "; ".join(filter(None, (describe(method), ", ".join(unusual))))
            lines.append(Line(tuple(cells), text, "ours" if method == ours else ""))
        lines.sort(key=lambda line: line.cells[1].value.replace(NO_VALUE, ""), reverse=True)
        heads = [Column("Method", is_text=True)]
        heads += [replace(score.column, note=f"n {counts[score]}") for score in columns]
        if gains:
            text = f"{columns[0].title}, on the queries and scenes that both have"
            heads.append(Column(f"{ours} minus it", text))
        scenes, places = (max(row[unit] for row in rows) for unit in ("scenes", "places"))
        notes = (
            f"{escape(protocol)}: {escape(', '.join(usual))}.",
            _describe_means(scenes, places),
        )
        tables.append(Table(tuple(heads), tuple(lines), f"{dataset} by {protocol}", notes))
    return tables


def _describe_means(scenes: int, places: int) -> str:
    """Describe the samples of a mean and its interval."""
    text = f"Mean over {scenes} scene{'s' if scenes > 1 else ''} of each scene's mean"
    if scenes == 1:
        text += "; one scene has no interval"
    elif places == 1:
        text += "; scenes of one place have no interval"
    else:
        units = "scenes"
        if places < scenes:
            units = f"{places} places that they show, and of scenes within these,"
        text += f"; with it where {LEVEL:.0%} of the resamplings of the {units} lie"
        text += ", rough with so few" if places < LEAST else ""
    return f"{text}. n are queries, each in one frame."


def difference_tables(
    pairs: Mapping[str, tuple[Sequence[Row], Sequence[Row]]], head: str = "Minus"
) -> list[Table]:
    """Return a table for each data set and protocol: a line per pair, first minus second.

    ``pairs`` are rows of the spec ``samples`` by the name of the line.
    """
    groups: dict[tuple[str, str], dict[str, dict[str, Difference]]] = {}
    for name, (rows, baseline) in pairs.items():
        for difference in differences(rows, baseline):
            by_name = groups.setdefault((difference.dataset, difference.protocol), {})
            by_name.setdefault(name, {})[difference.metric] = difference
    tables = []
    for (dataset, protocol), by_name in groups.items():
        columns = [s for s in scores_of(protocol) if any(s.metric in d for d in by_name.values())]
        if not columns:
            continue
        lines = [
            line_of([name, *(gain_cell(by_metric.get(s.metric), s) for s in columns)])
            for name, by_metric in by_name.items()
        ]
        gains = [d.gain for by_metric in by_name.values() for d in by_metric.values()]
        scenes, places = max(g.samples for g in gains), max(g.independent_samples for g in gains)
        unit = "places that they show" if places < scenes else "scenes"
        note = (
            f"On the queries that both were asked, in {scenes} scene{'s' if scenes > 1 else ''}; "
            f"with it where {LEVEL:.0%} of the resamplings of the {unit}, drawn in pairs, lie. "
        )
        note += (
            f"Of fewer than {LEAST} an interval says little."
            if places < LEAST
            else "Green is better beyond noise, red is worse; of so many comparisons one in twenty "
            "is so by chance."
        )
        heads = [head, *(score.column for score in columns)]
        tables.append(Table.of(heads, lines, f"{dataset} by {protocol}", [note]))
    return tables


def metrics_table(
    metrics: Mapping[str, Mapping[str, float]],
    scores: Sequence[Row] = (),
    title: str = "",
    links: Mapping[str, str] | None = None,
) -> Table:
    """Return a table with a line per scene and a line of means with intervals from ``scores``.

    The mean is unweighted over the scenes that have the metric.

    Parameters
    ----------
    metrics : {scene: {metric: float}}
    scores : rows of the spec ``scores``
        Scores in the protocol of the metrics; other numbers have no interval.
    title : str
    links : {scene: str}, optional
        Ids of the scenes' sections of the page.
    """
    columns = [m for m in METRICS if any(m.metric in values for values in metrics.values())]
    lines = [
        line_of(
            [
                Cell(scene, link=(links or {}).get(scene, "")),
                *(number(values.get(m.metric), m.digits) for m in columns),
            ]
        )
        for scene, values in metrics.items()
    ]
    by_metric = {score["metric"]: score for score in scores}
    means = [Cell("mean")]
    for m in columns:
        mean = float(
            np.mean([values[m.metric] for values in metrics.values() if m.metric in values])
        )
        below = score_cell(by_metric.get(m.metric), m.digits).below
        means.append(Cell(f"{mean:.{m.digits}f}", below))
    heads = ["scene", *(m.column for m in columns)]
    return Table.of(heads, [*lines, line_of(means, "mean")], title)


def gain_cell(difference: Difference | None, score: Score, is_worded: bool = False) -> Cell:
    """Format a difference, with its verdict in words if ``is_worded``."""
    if difference is None:
        return Cell(NO_VALUE)
    gain = difference.gain
    cell = comparison_cell(gain, score.digits, score.sign)
    note = f"{difference.samples} samples of {gain.samples} scene{'s' if gain.samples > 1 else ''}"
    below = [cell.below] * (gain.independent_samples > 1) + [VERDICTS[cell.mark]] * is_worded
    return replace(cell, below=", ".join(below), note=note)


def comparison_cell(gain: Comparison, digits: int, sign: int = 1) -> Cell:
    """Format a gain with its interval and mark; ``sign`` is -1 if lower is better.

    A gain is significant if its printed interval excludes 0, so not if it ends at 0.000. With fewer
    than :data:`LEAST` places no gain is significant.
    """
    value, start, end = (
        round(end, digits) + 0.0  # and not -0.000
        for end in (gain.difference, gain.low, gain.high)
    )
    low, high = sorted((sign * start, sign * end))
    mark = "better" if low > 0 else "worse" if high < 0 else "noise"
    if gain.independent_samples < 2 or (gain.independent_samples < LEAST and mark != "noise"):
        mark = "few"
    return Cell(f"{value:+.{digits}f}", f"{start:+.{digits}f} to {end:+.{digits}f}", mark)


def describe(method: str) -> str:
    """Describe a method, and state if it is not the original; empty if unknown."""
    return ROWS[method].about if method in ROWS else ""


def conditions(score: Row) -> str:
    """Describe the settings of a score, a row of the spec ``scores`` or ``samples``."""
    selection: str = score["selection"]
    parts = [SELECTIONS.get(selection, selection)]
    for name in ("threshold", "share", "filter", "temperature"):
        if (value := score[name]) is not None:
            parts.append(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}")
    for title, name in (("phrases", "canonical"), ("absent", "absent")):
        if score[name] is not None:
            parts.append(f"{title}: {score[name]}")
    return ", ".join(parts)


def score_cell(row: Row | None, digits: int) -> Cell:
    """Format a score with its interval."""
    if row is None:
        return Cell(NO_VALUE)
    ends = row["low"], row["high"]
    below = "" if None in ends else "–".join(f"{end:.{digits}f}" for end in ends)
    return Cell(f"{row['value']:.{digits}f}", below)


def _commonest(values: Iterable[Any]) -> Any:
    """Return the most common value, the first in a tie."""
    return Counter(values).most_common(1)[0][0]
