"""The paper's tables (arXiv 2412.08331) with its printed numbers and those of a run.

A cell has a number of the run only if the paper's scene was run: a scene of LERF-OVS or 3D-OVS,
identified by its content (:mod:`slgaussian.datasets.published`), not by its folder name. Other
scenes of these names are listed below the table. An overall mean requires all scenes of the table.
The paper used its own networks and unpublished pairs of views, so numbers for other pairs of the
same scene are not directly comparable.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from slgaussian.benchmark.reports.model import (
    Block,
    Cell,
    Column,
    Line,
    Prose,
    Section,
    Table,
    escape,
)
from slgaussian.benchmark.reports.score_tables import conditions
from slgaussian.benchmark.scores import score_table
from slgaussian.datasets.published import ANOTHER, UNVERIFIED, Standing

Row = Mapping[str, Any]

ABSENT = "data not present"
PROTOCOLS = ("slgaussian", "langsplat")
"""Protocols for the run's numbers; the paper does not name its protocol."""

ABOUT = (
    "Each cell has the number printed in the paper (arXiv 2412.08331), and below it the number of "
    "this run. Columns and rows have the paper's method names, and below them the names of the "
    "methods here. Methods called “like” are not the original programs. The paper used other "
    "networks and unpublished pairs of views, so its numbers are not directly comparable."
)


def _read_tables() -> list[dict[str, Any]]:
    """Read the tables; in a table of scenes, the last line is the mean over all scenes."""
    tables = tomllib.loads((files(__package__) / "paper_tables.toml").read_text("utf-8"))["table"]
    for table in tables:
        if table["by_scene"]:
            scenes = [line["title"] for line in table["lines"][:-1]]
            for line in table["lines"]:
                line["scenes"] = scenes if line["title"] == "overall" else [line["title"]]
    return tables


TABLES = _read_tables()
"""Tables 1 to 4 from `paper_tables.toml`."""


def paper_section(
    rows: Sequence[Row], places: Mapping[str, Standing], ours: str = "slgaussian"
) -> Section | None:
    """Return Tables 1 to 4 for each of :data:`PROTOCOLS` with a number of this run.

    Return None if there is neither a number nor a scene with the name of one in the tables.

    Parameters
    ----------
    rows : sequence
        Rows of the spec ``samples``, of all methods.
    places : {scene: Standing}
        Relation of the rows' scenes to published scenes of the same content or name: a pair of
        views of a LERF-OVS scene is a sample of that scene.
    ours : str
        Name of our method in the rows.
    """
    run = _Run(rows, places, ours)
    scored = [protocol for protocol in PROTOCOLS if run.has_scores(protocol)]
    shown = scored or PROTOCOLS[:1]
    formats = {table.get("format") for table in TABLES}
    others: dict[tuple[str, str, str], list[str]] = {}
    for name, of in places.items():
        if of.standing == ANOTHER and of.format in formats:
            others.setdefault((of.format, of.scene, of.why), []).append(name)
    if not scored and not others:
        return None
    blocks: list[Block] = [Prose(ABOUT)]
    for protocol in shown:
        for table in TABLES:
            notes = run.notes({c.get("protocol", protocol) for c in table["columns"]})
            if protocol == shown[0] and table["by_scene"]:
                notes += [
                    escape(
                        f"{names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}: named "
                        f"{scene}, but not the published scene ({reason}); not in the table."
                    )
                    for (format, scene, reason), names in others.items()
                    if format == table["format"]
                ]
            blocks.append(_table(table, run, protocol, notes))
    return Section("The paper's tables", blocks, "paper", link="The paper's tables")


def _table(table: Mapping[str, Any], run: _Run, protocol: str, notes: Sequence[str]) -> Table:
    columns = table["columns"]
    lines = []
    for line in table["lines"]:
        cells = [Cell(line["title"].replace("_", " "))]
        for column, printed in zip(columns, line["numbers"], strict=True):
            text = f"{printed:g}" if column["metric"] == "seconds" else f"{printed:.2f}"
            below = run.number({"protocol": protocol, **table, **line, **column})
            cells.append(Cell(text, below))
        name = run.name(line.get("method", ""))
        lines.append(Line(tuple(cells), name, "mean" if line["title"] == "overall" else ""))
    heads = [
        Column(column["title"], "", column.get("group", ""), run.name(column.get("method", "")))
        for column in columns
    ]
    return Table((Column("", is_text=True), *heads), tuple(lines), table["title"], tuple(notes))


class _Run:
    """Scores of a run on the paper's data; arguments as in :func:`paper_section`."""

    def __init__(self, rows: Sequence[Row], places: Mapping[str, Standing], ours: str) -> None:
        self.ours = ours
        self.unsure = {(o.format, o.scene) for o in places.values() if o.standing == UNVERIFIED}
        recognised = []
        for row in rows:
            place = places.get(row["scene"])
            if place is not None and place.standing != ANOTHER:
                method = "slgaussian" if row["method"] == ours else row["method"]
                frame = f"{row['scene']}/{row['frame']}"  # two pairs may share a target frame
                named = {"dataset": place.format, "scene": place.scene, "method": method}
                recognised.append({**row, **named, "frame": frame})
        self.scenes = {(row["dataset"], row["scene"]) for row in recognised}
        self.methods = {row["method"] for row in recognised}
        single = [{**row, "dataset": f"{row['dataset']}/{row['scene']}"} for row in recognised]
        self.scores = {
            (score["dataset"], score["method"], score["protocol"].partition("@")[0], name): score
            for of in (recognised, single)
            for score in score_table(of).to_pylist()
            if (name := score["metric"]) in ("iou", "hit_box", "miou")
        }

    def has_scores(self, protocol: str) -> bool:
        return any(name == protocol for _, _, name, _ in self.scores)

    def number(self, cell: Mapping[str, Any]) -> str:
        """Format the score of a cell, %, with its samples, or the reason why there is none.

        ``cell`` contains data format, scenes, method, protocol and metric.
        """
        if cell["metric"] == "seconds":
            return "see Speed"
        format, scenes = cell["format"], cell["scenes"]
        present = sum((format, scene) in self.scenes for scene in scenes)
        if not present:
            return ABSENT
        if present < len(scenes):
            return f"{present} of {len(scenes)} scenes present"
        if cell["method"] not in self.methods:
            return "not run"
        dataset = f"{format}/{scenes[0]}" if len(scenes) == 1 else format
        key = dataset, cell["method"], cell["protocol"], cell["metric"]
        if (score := self.scores.get(key)) is None:
            return "not scored"
        bounds = [score["low"], score["high"]]
        interval = "" if None in bounds else f" ({100 * bounds[0]:.2f}–{100 * bounds[1]:.2f})"
        mark = f", {UNVERIFIED}" if any((format, name) in self.unsure for name in scenes) else ""
        return f"{100 * score['value']:.2f}{interval}, n {score['samples']}{mark}"

    def name(self, method: str) -> str:
        """Return the name of a method in the rows."""
        return self.ours if method == "slgaussian" else method

    def notes(self, protocols: set[str]) -> list[str]:
        """Describe the settings of the numbers of the given protocols."""
        settings = {
            f"{score['protocol']} ({conditions(score)})"
            for (_, _, name, _), score in self.scores.items()
            if name in protocols
        }
        return [f"This run: {escape('; '.join(sorted(settings)))}."] if settings else []
