"""The paper's tables (arXiv 2412.08331), its printed numbers beside those of a run.

A number of this run stands only where the paper's own scene was run: a scene of LERF-OVS or 3D-OVS,
known by its content (:mod:`slgaussian.datasets.published`), not by a folder's name. What is called
like one and is not, is said below the table. An overall stands only where all scenes of the table
are there. The paper's numbers are of its networks and its own pairs of views, which were
never published: another pair of the same scene is another question.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

from slgaussian.benchmark.baselines import PAPER_ABLATION
from slgaussian.benchmark.costs import PAPER_SECONDS
from slgaussian.benchmark.reports.model import Cell, Column, Line, Prose, Section, Table, escape
from slgaussian.benchmark.reports.score_tables import conditions
from slgaussian.benchmark.scores import score_table
from slgaussian.datasets.published import ANOTHER, UNVERIFIED, Standing

Row = Mapping[str, Any]

LERF, OVS3D = "lerf_ovs", "ovs3d"
"""Formats of the data that the paper was scored on."""

ABSENT = "data not present"
PROTOCOLS = ("slgaussian", "langsplat")
"""By which a run is printed beside the paper, which names none."""

ABOUT = (
    "Of each cell the paper's number (arXiv 2412.08331) is first, as it is printed there, under "
    "the name of its method; this run's is below it, and so is the name of what ran here. What is "
    "called “like” is not the original. The paper's pairs of views were never published, and its "
    "networks are others: its numbers are no target for this run's pairs."
)


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


_PAPER = tomllib.loads((files(__package__) / "paper_tables.toml").read_text("utf-8"))

TABLES = tuple(
    _Source(
        one["title"],
        one["format"],
        tuple(one["scenes"]),
        tuple(
            _Group(
                group["title"],
                group["metric"],
                tuple(map(tuple, group["methods"])),
                tuple(map(tuple, group["numbers"])),
                group.get("protocol"),
            )
            for group in one["group"]
        ),
    )
    for one in _PAPER["table"]
)
"""Tables 1 and 2."""

ABLATION_NUMBERS = tuple(map(tuple, _PAPER["ablation"]["numbers"]))
"""The numbers of Table 3, in the order of :data:`slgaussian.benchmark.baselines.PAPER_ABLATION`."""

QUERY_2D_NUMBERS = {name: tuple(_PAPER["query-2d"][name]) for name in PAPER_SECONDS}
"""The numbers of Table 4: chosen IoU and localization accuracy, %."""


def paper_section(
    rows: Sequence[Row], places: Mapping[str, Standing], ours: str = "slgaussian"
) -> Section | None:
    """Return Tables 1 to 4 for each of :data:`PROTOCOLS` that has a number of this run.

    None if there is neither a number nor a scene that is called like one of the tables.

    Parameters
    ----------
    rows : sequence
        Of the spec ``samples``, of all methods.
    places : {scene: Standing}
        Of the scenes of the rows that are published ones, or called like one: a pair of views of a
        scene of LERF-OVS is a sample of that scene.
    ours : str
        Name of our method in the rows.
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
    tables = []
    for protocol in PROTOCOLS:
        own = [_scenes_table(source, run, protocol) for source in TABLES]
        own += [_ablation_table(run, protocol), _query_2d_table(run, protocol)]
        if protocol == PROTOCOLS[0] or run.has_scores(protocol):
            tables += own
    notes = [_others(source.format, places) for source in TABLES]
    if not any(notes) and not any(map(run.has_scores, PROTOCOLS)):
        return None
    for k, more in enumerate(notes):
        tables[k] = replace(tables[k], notes=(*tables[k].notes, *more))
    return Section(
        "The paper's tables", [Prose(ABOUT), *tables], "paper", link="The paper's tables"
    )


def _others(format: str, places: Mapping[str, Standing]) -> list[str]:
    """Describe scenes called like those of a data set that are others."""
    by_reason: dict[tuple[str, str], list[str]] = {}
    for name, of in places.items():
        if of.format == format and of.standing == ANOTHER:
            by_reason.setdefault((of.scene, of.why), []).append(name)
    return [
        escape(
            f"{names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}: called {scene}, but "
            f"not the published scene ({reason}); in no cell."
        )
        for (scene, reason), names in by_reason.items()
    ]


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

    def has_scores(self, protocol: str) -> bool:
        return any(name == protocol for _, _, name, _ in self.scores)

    def number(
        self, format: str, scenes: Sequence[str], method: str, protocol: str, metric: str
    ) -> str:
        """Return the score as it is printed, %, with its samples, or the reason for none."""
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

    def name(self, method: str) -> str:
        """Return the name of a method in the rows."""
        return self.ours if method == "slgaussian" else method

    def notes(self, protocols: Sequence[str]) -> tuple[str, ...]:
        """Describe what the numbers by some protocols go by."""
        by = {
            f"{score['protocol']} ({conditions(score)})"
            for (_, _, name, _), score in self.scores.items()
            if name in protocols
        }
        return (f"This run by {escape('; '.join(sorted(by)))}.",) if by else ()


def _scenes_table(source: _Source, run: _Run, protocol: str) -> Table:
    lines = []
    for i, scenes in enumerate([*((scene,) for scene in source.scenes), source.scenes]):
        label = scenes[0].replace("_", " ") if len(scenes) == 1 else "overall"
        cells = [Cell(label)]
        for group in source.groups:
            top = max(group.numbers[i])
            for (_, method), paper in zip(group.methods, group.numbers[i], strict=True):
                by = group.protocol or protocol
                mine = run.number(source.format, scenes, method, by, group.metric)
                cells.append(Cell(f"{paper:.2f}", mine, "best" if paper == top else ""))
        lines.append(Line(tuple(cells), style="" if len(scenes) == 1 else "mean"))
    columns = [
        Column(paper, group=group.title, note=run.name(method))
        for group in source.groups
        for paper, method in group.methods
    ]
    notes = run.notes([group.protocol or protocol for group in source.groups])
    head = Column("", is_text=True)
    return Table((head, *columns), tuple(lines), source.title, notes)


def _ablation_table(run: _Run, protocol: str) -> Table:
    lines = []
    last, scenes = len(ABLATION_NUMBERS) - 1, _PAPER["ablation"]["scenes"]
    for k, ((parts, method), numbers) in enumerate(
        zip(PAPER_ABLATION.items(), ABLATION_NUMBERS, strict=True)
    ):
        names = ("feed-forward model", "MA", "MV-LMB")
        label = " + ".join(n for n, on in zip(names, parts, strict=True) if on) or "none of them"
        cells = [
            Cell(
                f"{paper:.2f}",
                run.number(format, (scene,), method, protocol, "iou"),
                "best" if k == last else "",
            )
            for (format, scene), paper in zip(scenes, numbers, strict=True)
        ]
        lines.append(Line((Cell(label), *cells), run.name(method)))
    columns = [Column(scene.replace("_", " "), group="Chosen IoU (%)") for _, scene in scenes]
    head = Column("", is_text=True)
    return Table(
        (head, *columns), tuple(lines), _PAPER["ablation"]["title"], run.notes((protocol,))
    )


def _query_2d_table(run: _Run, protocol: str) -> Table:
    best = {("query-2d", "iou"), ("slgaussian", "hit_box"), ("slgaussian", "seconds")}
    lines = []
    for method, title in (("query-2d", "2D Query"), ("slgaussian", "SLGaussian")):
        cells = [Cell(title)]
        for paper, metric in zip(QUERY_2D_NUMBERS[method], ("iou", "hit_box"), strict=True):
            mine = run.number(LERF, TABLES[0].scenes, method, protocol, metric)
            cells.append(Cell(f"{paper:.2f}", mine, "best" if (method, metric) in best else ""))
        mark = "best" if (method, "seconds") in best else ""
        cells.append(Cell(f"{PAPER_SECONDS[method]:g}", "under the times", mark))
        lines.append(Line(tuple(cells), run.name(method)))
    heads = [
        Column("", is_text=True),
        *map(Column, ("Chosen IoU (%)", "Localization accuracy (%)")),
    ]
    columns = (*heads, Column("Speed (s/q)"))
    return Table(columns, tuple(lines), _PAPER["query-2d"]["title"], run.notes((protocol,)))
