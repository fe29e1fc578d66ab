"""Tables of scores: a row a method, best in bold, and the conditions that each number goes by."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.reports.model import NO_VALUE, Cell, Column, Line, Table, escape
from slgaussian.benchmark.scores import SCORE_CALIBRATION, Difference, differences
from slgaussian.benchmark.statistics import LEAST, LEVEL

Row = Mapping[str, Any]
Pairs = Mapping[str, tuple[Sequence[Row], Sequence[Row]]]


@dataclass(frozen=True)
class Score:
    """A score: its protocol without the version, its name there, and how it is printed.

    ``sign`` is -1 where less is better.
    """

    protocol: str
    metric: str
    title: str
    digits: int
    help: str
    sign: int = 1

    @property
    def key(self) -> tuple[str, str]:
        """Protocol and metric."""
        return self.protocol, self.metric

    def column(self, group: str = "", note: str = "") -> Column:
        """Return the column of the score in a table."""
        return Column(self.title + (" ↓" if self.sign < 0 else ""), self.help, group, note)


MAIN = (
    Score("slgaussian", "iou", "IoU", 3, "mask against label"),
    Score("slgaussian", "boundary_iou", "Boundary IoU", 3, "their rims"),
    Score("slgaussian", "miou", "mIoU", 3, "all texts compete for each pixel"),
    Score("slgaussian", "hit_mask", "Point in mask", 2, "one point lies on the object"),
    Score("slgaussian", "hit_box", "Point in box", 2, "the same, in its box"),
    Score("threshold-free", "average_precision", "AP", 3, "average precision of the relevancy"),
    Score("threshold-free", "auc", "AUC", 3, "area under the curve of true and false positives"),
    Score("threshold-free", "best_iou", "Best IoU", 3, "with the best threshold of each query"),
)
"""The scores that are looked at first."""

MORE = (
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
    Score("slgaussian", SCORE_CALIBRATION, "ECE, point", 3, "relevancy as a chance to hit", -1),
    Score("threshold-free", "calibration_error", "ECE, pixels", 3, "as a chance of a pixel", -1),
)
"""The scores that follow."""

SELECTIONS = {"none": "no mask", "given": "masks as given"}
"""What some selections are called in place of their names."""

VERDICTS = {
    "better": "ahead",
    "worse": "behind",
    "noise": "no difference beyond noise",
    "few": "too few places to tell",
}
"""Words by the mark of a difference, see :func:`gain_cell`."""


def method_tables(scores: Sequence[Row], shown: Sequence[Score] = MAIN) -> list[Table]:
    """Return a table for each data set of the rows of a table of the spec ``scores``.

    A score that no method has is left out. Where a method goes by other conditions than most, or
    has other samples, its line and cells say so. Of one method alone nothing is best.
    """
    tables = []
    for dataset in dict.fromkeys(row["dataset"] for row in scores):
        by_method: dict[str, dict[tuple[str, str], Row]] = {}
        for row in scores:
            if row["dataset"] == dataset and not is_of_curve(row):
                key = row["protocol"].partition("@")[0], row["metric"]
                by_method.setdefault(row["method"], {})[key] = row
        columns = [Column("Method", is_text=True)]
        cells = {method: [Cell(method)] for method in by_method}
        differing_conditions: dict[str, dict[str, None]] = {method: {} for method in by_method}
        common: dict[str, str] = {}
        for score in shown:
            present = [s[score.key] for s in by_method.values() if score.key in s]
            if not present:
                continue
            label, count = (_most(texts) for texts in zip(*map(_labels, present), strict=True))
            common.setdefault(label, _most(conditions(row) for row in present))
            columns.append(score.column(label, count))
            best = max(round(row["value"], score.digits) * score.sign for row in present)
            for method, by_score in by_method.items():
                cell = score_cell(by_score.get(score.key), score.digits)
                if score.key in by_score:
                    row = by_score[score.key]
                    is_best = round(row["value"], score.digits) * score.sign == best
                    samples = _labels(row)[1]
                    cell_notes = filter(None, [row["note"], "" if samples == count else samples])
                    mark = "best" if is_best and len(by_method) > 1 else ""
                    cell = replace(cell, mark=mark, note="; ".join(cell_notes))
                    usual = common[label].split(", ")
                    unusual = (c for c in conditions(row).split(", ") if c not in usual)
                    differing_conditions[method] |= dict.fromkeys(unusual)
                cells[method].append(cell)
        if len(columns) == 1:
            continue
        lines = [
            Line(
                tuple(line),
                "; ".join(filter(None, (about(method), ", ".join(differing_conditions[method])))),
            )
            for method, line in cells.items()
        ]
        every = [row for by_score in by_method.values() for row in by_score.values()]
        notes = [f"{escape(label)}: {escape(text)}." for label, text in common.items()]
        notes.append(
            _described(*(max(row[unit] for row in every) for unit in ("scenes", "places")))
        )
        tables.append(Table(tuple(columns), tuple(lines), dataset, tuple(notes)))
    return tables


def _labels(row: Row) -> tuple[str, str]:
    return row["protocol"], f"n {row['samples']}"


def _described(scenes: int, places: int) -> str:
    """Return what a mean is over, and what its interval is."""
    text = f"Mean over {scenes} scene{'s' if scenes > 1 else ''} of each scene's mean"
    if scenes == 1:
        text += "; one scene has no interval"
    elif places == 1:
        text += "; scenes of one place have no interval"
    else:
        drawn = "scenes"
        if places < scenes:
            drawn = f"{places} places that they show, and of scenes within these,"
        text += f"; with it where {LEVEL:.0%} of the resamplings of the {drawn} lie"
        text += ", rough with so few" if places < LEAST else ""
    return f"{text}. n are queries, each in one frame."


def difference_tables(
    pairs: Pairs, shown: Sequence[Score] = MAIN, head: str = "Minus"
) -> list[Table]:
    """Return a table for each data set: a line a pair of samples, the one minus the other."""
    by_dataset: dict[str, dict[str, dict[tuple[str, str], Difference]]] = {}
    for name, (rows, baseline) in pairs.items():
        for difference in differences(rows, baseline):
            if difference.threshold is None:
                key = difference.protocol.partition("@")[0], difference.metric
                by_score = by_dataset.setdefault(difference.dataset, {}).setdefault(name, {})
                by_score[key] = difference
    tables = []
    for dataset, by_name in by_dataset.items():
        present = [
            score for score in shown if any(score.key in by_score for by_score in by_name.values())
        ]
        if not present:
            continue
        labels = {key: d.protocol for by_score in by_name.values() for key, d in by_score.items()}
        columns = [Column(head, is_text=True), *(s.column(labels[s.key]) for s in present)]
        lines = [
            Line((Cell(name), *(gain_cell(by_score.get(score.key), score) for score in present)))
            for name, by_score in by_name.items()
        ]
        gains = [d.gain for by_score in by_name.values() for d in by_score.values()]
        scenes, places = max(g.samples for g in gains), max(g.drawn for g in gains)
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
        tables.append(Table(tuple(columns), tuple(lines), dataset, (note,)))
    return tables


def gain_cell(difference: Difference | None, score: Score, is_worded: bool = False) -> Cell:
    """Return a difference as it is printed; if ``is_worded`` with what it bears out.

    It is beyond noise if the interval is, as it is printed: one that ends at 0.000 is not. Of
    fewer than :data:`LEAST` places it is not, whatever its interval.
    """
    if difference is None:
        return Cell(NO_VALUE)
    gain, digits = difference.gain, score.digits
    value, start, end = (
        round(number, digits) + 0.0  # and not -0.000
        for number in (gain.difference, gain.low, gain.high)
    )
    note = f"{difference.samples} samples of {gain.samples} scene{'s' if gain.samples > 1 else ''}"
    low, high = sorted((score.sign * start, score.sign * end))
    mark = "better" if low > 0 else "worse" if high < 0 else "noise"
    if gain.drawn < 2 or (gain.drawn < LEAST and mark != "noise"):
        mark = "few"
    below = [f"{start:+.{digits}f} to {end:+.{digits}f}"] * (gain.drawn > 1)
    below += [VERDICTS[mark]] * is_worded
    return Cell(f"{value:+.{digits}f}", ", ".join(below), mark, note)


def about(method: str) -> str:
    """Describe a method, and of what is not the original that it is not; empty if not known."""
    return ROWS[method].about if method in ROWS else ""


def conditions(score: Row) -> str:
    """Describe what a score goes by: of a row of the spec ``scores``, or of ``samples``."""
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
    """Return a score with its interval as it is printed."""
    if row is None:
        return Cell(NO_VALUE)
    ends = row["low"], row["high"]
    below = "" if None in ends else "–".join(f"{end:.{digits}f}" for end in ends)
    return Cell(f"{row['value']:.{digits}f}", below)


def is_of_curve(row: Row) -> bool:
    """Tell whether a score is of a threshold that was tried."""
    return row["protocol"].startswith("threshold-free") and row["threshold"] is not None


def _most(texts: Iterable[str]) -> str:
    """Return the commonest, the first of several."""
    return Counter(texts).most_common(1)[0][0]
