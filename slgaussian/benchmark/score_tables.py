"""Scores as people read them: a row a method, best in bold, and what each number goes by.

HTML, Markdown and the terminal print these tables, so they say the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.scores import SCORE_CALIBRATION, Difference, differences
from slgaussian.benchmark.statistics import LEAST

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A score: its protocol without the version, its name there, and how it is printed.

    ``sign`` is -1 where less is better.
    """

    protocol: str
    metric: str
    title: str
    digits: int
    help: str
    sign: int = 1


MAIN = (
    Column("slgaussian", "iou", "IoU", 3, "mask against label"),
    Column("slgaussian", "boundary_iou", "Boundary IoU", 3, "their rims"),
    Column("slgaussian", "miou", "mIoU", 3, "all texts compete for each pixel"),
    Column("slgaussian", "hit_mask", "Point in mask", 2, "one point lies on the object"),
    Column("slgaussian", "hit_box", "Point in box", 2, "the same, in its box"),
    Column("threshold-free", "average_precision", "AP", 3, "average precision of the relevancy"),
    Column("threshold-free", "auc", "AUC", 3, "area under the curve of true and false positives"),
    Column("threshold-free", "best_iou", "Best IoU", 3, "with the best threshold of each query"),
)
"""The scores that are looked at first."""

MORE = (
    Column("langsplat", "iou", "IoU", 3, "smoothed, stretched relevancy above 0.4"),
    Column("langsplat", "boundary_iou", "Boundary IoU", 3, "their rims"),
    Column("langsplat", "hit_peak", "Peak in box", 2, "any of the most relevant pixels"),
    Column("langsplat", "hit_box", "Point in box", 2, "the middle one of them"),
    Column("langsplat-rescaled", "iou", "IoU", 3, "the same, filter scaled to the image"),
    Column("langsplat-rescaled", "hit_box", "Point in box", 2, "the same"),
    Column("3d-ovs", "miou", "mIoU", 3, "all texts compete for each pixel"),
    Column("3d-ovs", "accuracy", "Accuracy", 3, "pixels with the right class and no other"),
    Column("slgaussian", SCORE_CALIBRATION, "ECE, point", 3, "relevancy as a chance to hit", -1),
    Column("threshold-free", "calibration_error", "ECE, pixels", 3, "as a chance of a pixel", -1),
)
"""The scores that follow."""


@dataclass(frozen=True)
class Cell:
    """A printed score: value, interval, and what is to be said of it.

    ``mark`` is ``best``; or of a difference ``better``, ``worse``, ``noise`` or ``few``.
    """

    value: str
    interval: str = ""
    mark: str = ""
    note: str = ""


NOTHING = Cell("–")

SELECTIONS = {"none": "no mask", "given": "masks as given"}
"""What is said of some selections in place of their names."""


@dataclass(frozen=True)
class Group:
    """Columns side by side of one protocol, and what their numbers go by."""

    protocol: str
    conditions: str
    columns: tuple[Column, ...]
    counts: tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """A method, what it is, its scores, and the conditions of its own that they go by."""

    method: str
    about: str
    cells: tuple[Cell, ...]
    by: str = ""


@dataclass(frozen=True)
class Table:
    """Scores of a data set.

    ``places`` are what its scenes show, which the resamplings draw: fewer where the data say so.
    """

    dataset: str
    scenes: int
    places: int
    groups: tuple[Group, ...]
    lines: tuple[Line, ...]

    @property
    def columns(self) -> list[Column]:
        """The columns of all groups."""
        return [column for group in self.groups for column in group.columns]

    @property
    def counts(self) -> list[str]:
        """Samples of each column."""
        return [count for group in self.groups for count in group.counts]


def method_tables(scores: Sequence[Row], columns: Sequence[Column] = MAIN) -> list[Table]:
    """A table a data set of the rows of a table of the spec ``scores``.

    A column that no method has is left out. Where a method goes by other conditions than most, or
    has other samples, its cells say so. Of one method alone nothing is best.
    """
    found = []
    for dataset in dict.fromkeys(row["dataset"] for row in scores):
        own = {
            (row["method"], row["protocol"].partition("@")[0], row["metric"]): row
            for row in scores
            if row["dataset"] == dataset and not _is_of_curve(row)
        }
        methods = list(dict.fromkeys(method for method, *_ in own))
        groups = []
        cells: dict[str, list[Cell]] = {method: [] for method in methods}
        by: dict[str, list[str]] = {method: [] for method in methods}
        for protocol in dict.fromkeys(column.protocol for column in columns):
            group = [
                column
                for column in columns
                if column.protocol == protocol
                and any((method, protocol, column.metric) in own for method in methods)
            ]
            if not group:
                continue
            said, counts = "", []
            for column in group:
                by_method = {m: own.get((m, protocol, column.metric)) for m in methods}
                there = [score for score in by_method.values() if score is not None]
                said = _most(conditions(score) for score in there)
                counts.append(_most(f"n {score['samples']}" for score in there))
                best = None
                if len(methods) > 1:
                    best = max(_printed(score, column) * column.sign for score in there)
                for method, score in by_method.items():
                    by[method] += [] if score is None else _others(conditions(score), said)
                    cells[method].append(_cell(score, column, best, said, counts[-1]))
            label = _most(
                score["protocol"] for (_, name, _), score in own.items() if name == protocol
            )
            groups.append(Group(label, said, tuple(group), tuple(counts)))
        if groups:
            scenes = max(score["scenes"] for score in own.values())
            places = max(score["places"] for score in own.values())
            lines = (
                Line(m, about(m), tuple(cells[m]), ", ".join(dict.fromkeys(by[m]))) for m in methods
            )
            found.append(Table(dataset, scenes, places, tuple(groups), tuple(lines)))
    return found


def difference_tables(
    pairs: Mapping[str, tuple[Sequence[Row], Sequence[Row]]], columns: Sequence[Column] = MAIN
) -> list[Table]:
    """A table a data set: a line a pair of samples, the one minus the other, on what both have."""
    known: dict[str, dict[str, dict[tuple[str, str], Difference]]] = {}
    labels: dict[str, str] = {}
    for name, (rows, others) in pairs.items():
        for gain in differences(rows, others):
            protocol = gain.protocol.partition("@")[0]
            if gain.threshold is None:
                labels[protocol] = gain.protocol
                of = known.setdefault(gain.dataset, {}).setdefault(name, {})
                of[protocol, gain.metric] = gain
    tables = []
    for dataset, by_name in known.items():
        shown = [
            column
            for column in columns
            if any((column.protocol, column.metric) in of for of in by_name.values())
        ]
        groups = []
        for protocol in dict.fromkeys(column.protocol for column in shown):
            group = tuple(column for column in shown if column.protocol == protocol)
            groups.append(Group(labels[protocol], "", group, ("",) * len(group)))
        lines = []
        for name, of in by_name.items():
            found = (of.get((column.protocol, column.metric)) for column in shown)
            cells = tuple(
                NOTHING if gain is None else gain_cell(gain, column.digits, column.sign)
                for gain, column in zip(found, shown, strict=True)
            )
            lines.append(Line(name, "", cells))
        gains = [gain.gain for of in by_name.values() for gain in of.values()]
        counts = (max(gain.samples for gain in gains), max(gain.drawn for gain in gains))
        tables.append(Table(dataset, *counts, tuple(groups), tuple(lines)))
    return tables


def gain_cell(found: Difference, digits: int, sign: int = 1) -> Cell:
    """A difference as it is printed; ``sign`` is -1 where less is better.

    It is beyond noise if the interval is, as it is printed: one that ends at 0.000 is not.
    """
    gain = found.gain
    value, start, end = (
        round(number, digits) + 0.0  # and not -0.000
        for number in (gain.difference, gain.low, gain.high)
    )
    counts = f"{found.samples} samples of {gain.samples} scene{'s' if gain.samples > 1 else ''}"
    told = f"{value:+.{digits}f}"
    if gain.drawn < 2:
        return Cell(told, "", "few", counts)
    low, high = sorted((sign * start, sign * end))
    mark = "better" if low > 0 else "worse" if high < 0 else "noise"
    if gain.drawn < LEAST and mark != "noise":
        mark = "few"
    return Cell(told, f"{start:+.{digits}f} to {end:+.{digits}f}", mark, counts)


def about(method: str) -> str:
    """What a method is, and of what is not the original that it is not; empty if not known."""
    return ROWS[method].about if method in ROWS else ""


def conditions(score: Row) -> str:
    """What a score goes by: of a row of the spec ``scores``, or of ``samples``."""
    names = "threshold", "share", "filter", "temperature"
    said = [f"{name} {score[name]:g}" if isinstance(score[name], float) else f"{name} {score[name]}"
            for name in names if score[name] is not None]  # fmt: skip
    selection: str = score["selection"]
    said += [
        f"{title}: {score[name]}"
        for title, name in (("phrases", "canonical"), ("absent", "absent"))
        if score[name] is not None
    ]
    return ", ".join([SELECTIONS.get(selection, selection), *said])


def _others(conditions: str, said: str) -> list[str]:
    """The parts of some conditions that are not among those of most."""
    return [part for part in conditions.split(", ") if part not in said.split(", ")]


def _is_of_curve(score: Row) -> bool:
    return score["protocol"].startswith("threshold-free") and score["threshold"] is not None


def _printed(score: Row, column: Column) -> float:
    """The value as it is printed: what reads the same is as good."""
    return round(score["value"], column.digits)


def _cell(score: Row | None, column: Column, best: float | None, said: str, count: str) -> Cell:
    if score is None:
        return NOTHING
    ends = score["low"], score["high"]
    interval = "" if None in ends else "–".join(f"{end:.{column.digits}f}" for end in ends)
    notes = [score["note"]]
    if conditions(score) != said:
        notes.append(conditions(score))
    if f"n {score['samples']}" != count:
        notes.append(f"n {score['samples']}")
    mark = "best" if _printed(score, column) * column.sign == best else ""
    value = f"{score['value']:.{column.digits}f}"
    return Cell(value, interval, mark, "; ".join(filter(None, notes)))


def _most(texts: Iterable[str]) -> str:
    """The commonest, the first of several."""
    return Counter(texts).most_common(1)[0][0]
