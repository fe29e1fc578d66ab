"""The paper's tables (arXiv 2412.08331), its printed numbers beside those of a run.

A number of this run stands only where the paper's own scene was run: a scene of LERF-OVS or 3D-OVS,
known by its content (:mod:`slgaussian.datasets.published`), not by a folder's name. What is called
like one and is not, is said below the table. An overall stands only where all scenes of the table
are there. The paper's numbers are of its networks and its own pairs of views, which were
never published: another pair of the same scene is another question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

from slgaussian.benchmark.baselines import PAPER_ABLATION
from slgaussian.benchmark.score_tables import conditions
from slgaussian.benchmark.scores import score_table
from slgaussian.datasets.published import ANOTHER, UNVERIFIED, Standing

Row = Mapping[str, Any]

LERF, OVS3D = "lerf_ovs", "ovs3d"
"""Formats of the data that the paper was scored on."""

ABSENT = "data not present"
PROTOCOLS = ("slgaussian", "langsplat")
"""By which a run is printed beside the paper, which names none."""

SECONDS = {"slgaussian": 0.011, "query-2d": 18.0}
"""Seconds a query in a new view by the paper's Table 4, on its GPU."""


@dataclass(frozen=True)
class Name:
    """What a column or line is called: by the paper, and the row of methods that ran here.

    A likeness never stands under its original's name; ``here`` is empty where no method is meant.
    """

    paper: str
    here: str = ""


@dataclass(frozen=True)
class Printed:
    """A table of the paper with this run in it.

    Attributes
    ----------
    title, by : str
        Its caption, and what the numbers of this run go by.
    groups : tuple of (str, int)
        Headings over several columns, and of how many.
    columns : tuple of Name
    lines : tuple of (Name, cells)
        A cell is (the paper's number, this run's or why there is none); the paper's best is in
        bold there, and known by ``best``.
    best : set of (line, column)
    present : bool
        Whether there is any number of this run.
    notes : tuple of str
        A sentence a scene that is called like one of the table, and is not it.
    """

    title: str
    by: str
    groups: tuple[tuple[str, int], ...]
    columns: tuple[Name, ...]
    lines: tuple[tuple[Name, tuple[tuple[str, str], ...]], ...]
    best: frozenset[tuple[int, int]]
    present: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Group:
    """Columns of one metric: the paper's name of each method, ours, and its numbers by line."""

    title: str
    metric: str
    methods: tuple[tuple[str, str], ...]
    numbers: tuple[tuple[float, ...], ...]
    protocol: str | None = None


@dataclass(frozen=True)
class _Source:
    """A table of scenes as the paper has it; its last line is the mean over them."""

    title: str
    format: str
    scenes: tuple[str, ...]
    groups: tuple[_Group, ...]


_LERF = (("LERF", "lerf-like"), ("LangSplat", "langsplat-like"), ("SLGaussian", "slgaussian"))
TABLES = (
    _Source(
        "Table 1. 3D semantic segmentation (IoU, %) and localization accuracy (%) on LERF",
        LERF,
        ("figurines", "ramen", "teatime", "waldo_kitchen"),
        (
            _Group(
                "IoU (%)",
                "iou",
                _LERF,
                (
                    (20.88, 43.05, 47.28),
                    (16.06, 47.66, 55.21),
                    (21.64, 8.70, 40.65),
                    (15.12, 8.94, 22.86),
                    (18.43, 27.09, 41.50),
                ),
            ),
            _Group(
                "Localization accuracy (%)",
                "hit_box",
                _LERF,
                (
                    (58.33, 83.33, 91.67),
                    (40.00, 90.00, 80.00),
                    (62.50, 18.75, 50.00),
                    (46.15, 15.38, 61.54),
                    (51.75, 51.87, 70.80),
                ),
            ),
        ),
    ),
    _Source(
        "Table 2. 3D semantic segmentation on 3D-OVS",
        OVS3D,
        ("bed", "bench", "blue_sofa", "covered_desk", "lawn"),
        (
            _Group(
                "IoU (%)",
                "iou",
                _LERF,
                (
                    (20.85, 0.62, 66.60),
                    (26.51, 33.31, 81.35),
                    (14.21, 19.46, 50.48),
                    (7.57, 15.51, 51.97),
                    (0.00, 30.40, 60.70),
                    (13.83, 19.86, 62.22),
                ),
            ),
            _Group(
                "mIoU (%)",
                "miou",
                (_LERF[0], ("3D-OVS", "3d-ovs-like"), *_LERF[1:]),
                (
                    (12.67, 15.86, 1.72, 41.33),
                    (29.92, 17.16, 27.08, 47.02),
                    (23.65, 23.41, 6.23, 30.25),
                    (20.63, 18.13, 21.17, 47.67),
                    (5.50, 13.70, 31.69, 54.38),
                    (18.47, 17.65, 17.58, 44.13),
                ),
                "3d-ovs",
            ),
        ),
    ),
)
"""Tables 1 and 2."""

ABLATION = "Table 3. Ablation: chosen IoU (%)"
ABLATED = ((LERF, "teatime"), (OVS3D, "covered_desk"))
ABLATION_NUMBERS = ((8.70, 15.51), (6.58, 10.48), (10.84, 16.40), (40.65, 51.97))
"""The numbers of Table 3, in the order of :data:`slgaussian.benchmark.baselines.PAPER_ABLATION`."""

QUERY_2D = "Table 4. Querying a new view against the 2D query, LERF"
QUERY_2D_NUMBERS = {"query-2d": (44.64, 65.08), "slgaussian": (41.50, 70.80)}
"""The numbers of Table 4: chosen IoU and localization accuracy, %."""


def paper_tables(
    rows: Sequence[Row], places: Mapping[str, Standing], ours: str = "slgaussian"
) -> list[Printed]:
    """Tables 1 to 4 for each of :data:`PROTOCOLS`; for the first alone if none has a number.

    Parameters
    ----------
    rows : sequence
        Of the spec ``samples``, of all methods.
    places : {scene: Standing}
        Of the scenes of the rows that are published ones, or called like one: a pair of views of a
        scene of LERF-OVS is a sample of that scene.
    ours : str
        What the rows call our method.
    """
    known = []
    for row in rows:
        place = places.get(row["scene"])
        if place is not None and place.standing != ANOTHER:
            method = "slgaussian" if row["method"] == ours else row["method"]
            frame = f"{row['scene']}/{row['frame']}"  # two pairs may ask in one frame
            named = {"dataset": place.format, "scene": place.scene, "method": method}
            known.append({**row, **named, "frame": frame})
    unsure = {(of.format, of.scene) for of in places.values() if of.standing == UNVERIFIED}
    run = _Run(known, ours, unsure)
    made = []
    for protocol in PROTOCOLS:
        tables = [_scenes(source, run, protocol) for source in TABLES]
        tables += [_ablation(run, protocol), _query_2d(run, protocol)]
        if protocol == PROTOCOLS[0] or any(table.present for table in tables):
            made += tables
    for k, source in enumerate(TABLES):
        made[k] = replace(made[k], notes=_notes(source.format, places))
    return made


def _notes(format: str, places: Mapping[str, Standing]) -> tuple[str, ...]:
    """What is to be said of scenes called like those of a data set that are others."""
    by_reason: dict[tuple[str, str], list[str]] = {}
    for name, of in places.items():
        if of.format == format and of.standing == ANOTHER:
            by_reason.setdefault((of.scene, of.why), []).append(name)
    return tuple(
        f"{names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}: called {scene}, but not "
        f"the published scene ({why}); in no cell"
        for (scene, why), names in by_reason.items()
    )


class _Run:
    """The scores of a run on the paper's data."""

    def __init__(self, rows: Sequence[Row], ours: str, unsure: Set[tuple[str, str]]) -> None:
        self.ours, self.unsure = ours, unsure
        self.scenes = {(row["dataset"], row["scene"]) for row in rows}
        self.methods = {row["method"] for row in rows}
        alone = [{**row, "dataset": f"{row['dataset']}/{row['scene']}"} for row in rows]
        self.scores = {
            (score["dataset"], score["method"], score["protocol"].partition("@")[0], name): score
            for of in (rows, alone)
            for score in score_table(of).to_pylist()
            if (name := score["metric"]) in ("iou", "hit_box", "miou")
            and not score["protocol"].startswith("threshold-free")
        }

    def number(
        self, format: str, scenes: Sequence[str], method: str, protocol: str, metric: str
    ) -> str:
        """The score as it is printed, %, with its samples, or why there is none."""
        there = [scene for scene in scenes if (format, scene) in self.scenes]
        if not there:
            return ABSENT
        if len(there) < len(scenes):
            return f"{len(there)} of {len(scenes)} scenes present"
        if method not in self.methods:
            return "not run"
        dataset = f"{format}/{scenes[0]}" if len(scenes) == 1 else format
        score = self.scores.get((dataset, method, protocol, metric))
        if score is None:
            return "not scored"
        ends = [score["low"], score["high"]]
        interval = "" if None in ends else f" ({100 * ends[0]:.2f}–{100 * ends[1]:.2f})"
        mark = f", {UNVERIFIED}" if any((format, name) in self.unsure for name in scenes) else ""
        return f"{100 * score['value']:.2f}{interval}, n {score['samples']}{mark}"

    def name(self, paper: str, method: str) -> Name:
        """What a method is called, as the rows have it."""
        return Name(paper, self.ours if method == "slgaussian" else method)

    def by(self, protocols: Sequence[str]) -> str:
        """What the numbers by some protocols go by."""
        said = {
            f"{score['protocol']} ({conditions(score)})"
            for (_, _, name, _), score in self.scores.items()
            if name in protocols
        }
        return "; ".join(sorted(said))


def _scenes(source: _Source, run: _Run, protocol: str) -> Printed:
    each = [(scene,) for scene in source.scenes]
    lines, best = [], set()
    for i, scenes in enumerate([*each, source.scenes]):
        cells: list[tuple[str, str]] = []
        for group in source.groups:
            top = max(group.numbers[i])
            for (_, method), number in zip(group.methods, group.numbers[i], strict=True):
                if number == top:
                    best.add((i, len(cells)))
                by = group.protocol or protocol
                mine = run.number(source.format, scenes, method, by, group.metric)
                cells.append((f"{number:.2f}", mine))
        label = scenes[0].replace("_", " ") if len(scenes) == 1 else "overall"
        lines.append((Name(label), tuple(cells)))
    used = [group.protocol or protocol for group in source.groups]
    return Printed(
        source.title,
        run.by(used),
        tuple((group.title, len(group.methods)) for group in source.groups),
        tuple(run.name(*method) for group in source.groups for method in group.methods),
        tuple(lines),
        frozenset(best),
        _any_number(lines),
    )


def _ablation(run: _Run, protocol: str) -> Printed:
    lines = []
    for (parts, method), numbers in zip(PAPER_ABLATION.items(), ABLATION_NUMBERS, strict=True):
        names = ("feed-forward model", "MA", "MV-LMB")
        label = " + ".join(n for n, on in zip(names, parts, strict=True) if on) or "none of them"
        cells = tuple(
            (f"{number:.2f}", run.number(format, (scene,), method, protocol, "iou"))
            for (format, scene), number in zip(ABLATED, numbers, strict=True)
        )
        lines.append((run.name(label, method), cells))
    columns = tuple(Name(scene.replace("_", " ")) for _, scene in ABLATED)
    best = frozenset((len(lines) - 1, k) for k in range(len(columns)))
    groups = (("Chosen IoU (%)", len(columns)),)
    return Printed(
        ABLATION, run.by((protocol,)), groups, columns, tuple(lines), best, _any_number(lines)
    )


def _query_2d(run: _Run, protocol: str) -> Printed:
    names = {"query-2d": "2D Query", "slgaussian": "SLGaussian"}
    lines = []
    for method, numbers in QUERY_2D_NUMBERS.items():
        cells = [
            (f"{number:.2f}", run.number(LERF, TABLES[0].scenes, method, protocol, metric))
            for number, metric in zip(numbers, ("iou", "hit_box"), strict=True)
        ]
        seconds = (f"{SECONDS[method]:g}", "under the times")
        lines.append((run.name(names[method], method), (*cells, seconds)))
    columns = (Name("Chosen IoU (%)"), Name("Localization accuracy (%)"), Name("Speed (s/q)"))
    best = frozenset({(0, 0), (1, 1), (1, 2)})
    return Printed(
        QUERY_2D,
        run.by((protocol,)),
        (),
        columns,
        tuple(lines),
        best,
        _any_number([(name, cells[:-1]) for name, cells in lines]),
    )


def _any_number(lines: Sequence[tuple[Name, Sequence[tuple[str, str]]]]) -> bool:
    return any(mine[:1].isdigit() and ", n " in mine for _, cells in lines for _, mine in cells)
