"""The paper's tables (arXiv 2412.08331) with its printed numbers and those of a run.

A cell has a number of the run only if the paper's scene was run: a scene of LERF-OVS or 3D-OVS with
its name and labelled frames (:func:`slgaussian.datasets.labelled_sets.is_published`). An overall
mean requires all scenes of the table. The paper used its own networks and unpublished pairs of
views, so numbers for other pairs of the same scene are not directly comparable.
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
from slgaussian.datasets.labelled_sets import PUBLISHED

Row = Mapping[str, Any]

ABSENT = "data not present"
ANOTHER = "another scene"
"""A scene of this name was run, but its labelled frames are not the published ones."""

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
    rows: Sequence[Row], data: Mapping[str, Mapping[str, Any]], ours: str = "slgaussian"
) -> Section | None:
    """Return Tables 1 to 4 for each of :data:`PROTOCOLS` with a number of this run.

    Return None if there is neither a number nor a scene with the name of one in the tables.

    Args:
        rows: Rows of the spec ``samples``, of all methods.
        data: {scene: {"format", "scene", "published"}}. Data set and scene of the rows' scenes, and
            whether it is the published scene: a pair of views of a LERF-OVS scene is a sample of
            that scene.
        ours: Name of our method in the rows.
    """
    run = _Run(rows, data, ours)
    scored = [protocol for protocol in PROTOCOLS if run.has_scores(protocol)]
    shown = scored or PROTOCOLS[:1]
    if not scored and not run.others:
        return None
    blocks: list[Block] = [Prose(ABOUT)]
    for protocol in shown:
        for table in TABLES:
            notes = run.notes({c.get("protocol", protocol) for c in table["columns"]})
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
    heads = [Column(column["title"], note=run.name(column.get("method", ""))) for column in columns]
    return Table((Column("", is_text=True), *heads), tuple(lines), table["title"], tuple(notes))


class _Run:
    """Scores of a run on the paper's data; arguments as in :func:`paper_section`."""

    def __init__(
        self, rows: Sequence[Row], data: Mapping[str, Mapping[str, Any]], ours: str
    ) -> None:
        self.ours = ours
        self.others = {
            (of["format"], of["scene"])
            for of in data.values()
            if of["scene"] in PUBLISHED.get(of["format"], {}) and not of["published"]
        }
        published = []
        for row in rows:
            of = data.get(row["scene"])
            if of is not None and of["published"]:
                method = "slgaussian" if row["method"] == ours else row["method"]
                frame = f"{row['scene']}/{row['frame']}"  # two pairs may share a target frame
                named = {"dataset": of["format"], "scene": of["scene"], "method": method}
                published.append({**row, **named, "frame": frame})
        self.scenes = {(row["dataset"], row["scene"]) for row in published}
        self.methods = {row["method"] for row in published}
        single = [{**row, "dataset": f"{row['dataset']}/{row['scene']}"} for row in published]
        self.scores = {
            (score["dataset"], score["method"], score["protocol"].partition("@")[0], name): score
            for of in (published, single)
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
            is_other = any((format, scene) in self.others for scene in scenes)
            return ANOTHER if is_other else ABSENT
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
        return f"{100 * score['value']:.2f}{interval}, n {score['samples']}"

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
