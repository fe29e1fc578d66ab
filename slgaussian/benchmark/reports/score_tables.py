"""Tables of scores: a row a method, best in bold, and the conditions that each number goes by."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slgaussian.benchmark.baselines import ROWS
from slgaussian.benchmark.reports.model import NO_VALUE, Cell, Column, Line, Table, escape
from slgaussian.benchmark.scores import SCORE_CALIBRATION, Difference, differences
from slgaussian.benchmark.statistics import LEAST, LEVEL

Row = Mapping[str, Any]


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


def method_tables(scores: Sequence[Row], shown: Sequence[Score] = MAIN) -> list[Table]:
    """Return a table for each data set of the rows of a table of the spec ``scores``.

    A score that no method has is left out. Where a method goes by other conditions than most, or
    has other samples, its line and cells say so. Of one method alone nothing is best.
    """
    tables = []
    for dataset in dict.fromkeys(row["dataset"] for row in scores):
        by_key = {
            (row["method"], row["protocol"].partition("@")[0], row["metric"]): row
            for row in scores
            if row["dataset"] == dataset and not is_of_curve(row)
        }
        methods = list(dict.fromkeys(method for method, *_ in by_key))
        columns, notes = [], []
        cells: dict[str, list[Cell]] = {method: [] for method in methods}
        differing: dict[str, list[str]] = {method: [] for method in methods}
        common: dict[str, str] = {}
        for score in shown:
            by_method = {m: by_key.get((m, score.protocol, score.metric)) for m in methods}
            present = [row for row in by_method.values() if row is not None]
            if not present:
                continue
            label = _most(row["protocol"] for row in present)
            if label not in common:
                common[label] = _most(conditions(row) for row in present)
                notes.append(f"{escape(label)}: {escape(common[label])}.")
            count = _most(f"n {row['samples']}" for row in present)
            columns.append(score.column(label, count))
            best = None
            if len(methods) > 1:
                best = max(round(row["value"], score.digits) * score.sign for row in present)
            for method, row in by_method.items():
                cells[method].append(_cell(row, score, best, common[label], count))
                if row is not None:
                    parts = common[label].split(", ")
                    differing[method] += [
                        part for part in conditions(row).split(", ") if part not in parts
                    ]
        if not columns:
            continue
        lines = []
        for method in methods:
            apart = ", ".join(dict.fromkeys(differing[method]))
            description = "; ".join(filter(None, (about(method), apart)))
            lines.append(Line((Cell(method), *cells[method]), description))
        scenes, places = (
            max(row[name] for row in by_key.values()) for name in ("scenes", "places")
        )
        notes.append(_described(scenes, places))
        head = Column("Method", is_text=True)
        tables.append(Table((head, *columns), tuple(lines), dataset, tuple(notes)))
    return tables


def _described(scenes: int, places: int) -> str:
    """Return what a mean is over, and what its interval is."""
    text = f"Mean over {scenes} scene{'s' if scenes > 1 else ''} of each scene's mean"
    if scenes == 1:
        text += "; one scene has no interval"
    elif places == 1:
        text += "; scenes of one place have no interval"
    else:
        drawn = (
            f"{places} places that they show, and of scenes within these,"
            if places < scenes
            else "scenes"
        )
        text += f"; below it where {LEVEL:.0%} of the resamplings of the {drawn} lie"
        text += ", rough with so few" if places < LEAST else ""
    return f"{text}. n are queries, each in one frame."


def difference_tables(
    pairs: Mapping[str, tuple[Sequence[Row], Sequence[Row]]],
    shown: Sequence[Score] = MAIN,
    head: str = "Minus",
) -> list[Table]:
    """Return a table for each data set: a line a pair of samples, the one minus the other."""
    by_dataset: dict[str, dict[str, dict[tuple[str, str], Difference]]] = {}
    for name, (rows, others) in pairs.items():
        for one in differences(rows, others):
            if one.threshold is None:
                key = one.protocol.partition("@")[0], one.metric
                by_dataset.setdefault(one.dataset, {}).setdefault(name, {})[key] = one
    tables = []
    for dataset, by_name in by_dataset.items():
        columns = [Column(head, is_text=True)]
        cells: dict[str, list[Cell]] = {name: [Cell(name)] for name in by_name}
        for score in shown:
            key = score.protocol, score.metric
            present = [known[key] for known in by_name.values() if key in known]
            if not present:
                continue
            columns.append(score.column(present[0].protocol))
            for name, known in by_name.items():
                cell = Cell(NO_VALUE) if key not in known else gain_cell(known[key], score)
                cells[name].append(cell)
        gains = [one.gain for known in by_name.values() for one in known.values()]
        scenes, places = max(g.samples for g in gains), max(g.drawn for g in gains)
        unit = "places that they show" if places < scenes else "scenes"
        note = (
            f"On the queries that both were asked, in {scenes} scene{'s' if scenes > 1 else ''}; "
            f"below it where {LEVEL:.0%} of the resamplings of the {unit}, drawn in pairs, lie. "
        )
        if places < LEAST:
            note += f"Of fewer than {LEAST} an interval says little."
        else:
            note += (
                "Green is better beyond noise, red is worse; of so many comparisons one in twenty "
                "is so by chance."
            )
        if len(columns) > 1:
            lines = tuple(Line(tuple(own)) for own in cells.values())
            tables.append(Table(tuple(columns), lines, dataset, (note,)))
    return tables


def gain_cell(difference: Difference, score: Score) -> Cell:
    """Return a difference as it is printed.

    It is beyond noise if the interval is, as it is printed: one that ends at 0.000 is not.
    """
    gain, digits = difference.gain, score.digits
    value, start, end = (
        round(number, digits) + 0.0  # and not -0.000
        for number in (gain.difference, gain.low, gain.high)
    )
    note = f"{difference.samples} samples of {gain.samples} scene{'s' if gain.samples > 1 else ''}"
    text = f"{value:+.{digits}f}"
    if gain.drawn < 2:
        return Cell(text, "", "few", note)
    low, high = sorted((score.sign * start, score.sign * end))
    mark = "better" if low > 0 else "worse" if high < 0 else "noise"
    if gain.drawn < LEAST and mark != "noise":
        mark = "few"
    return Cell(text, f"{start:+.{digits}f} to {end:+.{digits}f}", mark, note)


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


def _cell(row: Row | None, score: Score, best: float | None, common: str, count: str) -> Cell:
    if row is None:
        return Cell(NO_VALUE)
    notes = [row["note"]]
    if conditions(row) != common:
        notes.append(conditions(row))
    if f"n {row['samples']}" != count:
        notes.append(f"n {row['samples']}")
    printed = score_cell(row, score.digits)
    mark = "best" if round(row["value"], score.digits) * score.sign == best else ""
    return Cell(printed.value, printed.below, mark, "; ".join(filter(None, notes)))


def is_of_curve(row: Row) -> bool:
    """Tell whether a score is of a threshold that was tried."""
    return row["protocol"].startswith("threshold-free") and row["threshold"] is not None


def _most(texts: Iterable[str]) -> str:
    """Return the commonest, the first of several."""
    return Counter(texts).most_common(1)[0][0]


CLAIMS = {
    "better": "ahead of {other} by {gain}",
    "worse": "behind {other}: {gain}",
    "noise": "no difference beyond noise from {other}: {gain}",
    "few": "too few places to tell from {other}: {gain}",
}
"""Sentences by the mark of a difference, see :func:`gain_cell`."""


def claims(gains: Table) -> list[tuple[str, str]]:
    """Return what differences bear out by the first of :data:`MAIN`: (sentence, mark) a method.

    ``gains`` is of :func:`difference_tables`; without that score there is no claim. Where all of
    many bear out nothing, for want of places, one claim says so.
    """
    keys = [(column.group.partition("@")[0], column.title) for column in gains.columns]
    if (MAIN[0].protocol, MAIN[0].title) not in keys:
        return []
    place = keys.index((MAIN[0].protocol, MAIN[0].title))
    found = []
    for line in gains.lines:
        cell = line.cells[place]
        if cell.mark in CLAIMS:
            text = CLAIMS[cell.mark].format(other=escape(line.cells[0].value), gain=cell.text)
            found.append((text, cell.mark))
    if len(found) > 2 and all(mark == "few" for _, mark in found):
        return [(f"too few places to tell from any of the {len(found)} others", "few")]
    return found
