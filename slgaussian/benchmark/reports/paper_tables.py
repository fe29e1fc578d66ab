"""The paper's tables (arXiv 2412.08331) with its printed numbers and those of a run.

A cell has a number of the run only if the paper's scene was run: a scene of LERF-OVS or 3D-OVS with
its name and labelled frames (:func:`slgaussian.datasets.labelled_sets.is_published`). An overall
mean requires all scenes of the table. The paper used its own networks and unpublished pairs of
views, so numbers for other pairs of the same scene are not directly comparable.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from slgaussian.benchmark.reports.model import Block, Cell, Prose, Section, Table, escape
from slgaussian.benchmark.reports.score_tables import conditions
from slgaussian.benchmark.scores import score_table

Row = Mapping[str, Any]

PROTOCOLS = ("slgaussian", "langsplat")
"""Protocols for the run's numbers; the paper does not name its protocol."""

INTRODUCTION = (
    "Each cell has the number printed in the paper (arXiv 2412.08331), and below it the number of "
    "this run, if it has the scenes and the method. Columns and rows have the paper's method names "
    "and those of the methods here. Methods called “like” are not the original programs. The paper "
    "used other networks and unpublished pairs of views, so its numbers are not directly "
    "comparable. Seconds are in the section on speed."
)

TABLES: list[dict[str, Any]] = tomllib.loads(
    (files(__package__) / "paper_tables.toml").read_text("utf-8")
)["table"]
"""Tables 1 to 4; in a table of scenes, the last line is the mean over all scenes."""


def paper_section(
    rows: Iterable[Row], data: Mapping[str, Mapping[str, Any]], ours: str = "slgaussian"
) -> Section | None:
    """Return Tables 1 to 4 for each of :data:`PROTOCOLS` with a number of this run; None without.

    Args:
        rows: Rows of the spec ``samples``, of all methods.
        data: ``format``, ``scene`` and ``published`` of each scene of the rows: a pair of views of
            a published scene is a sample of that scene.
        ours: Name of our method in the rows.
    """
    scenes = {name: scene for name, scene in data.items() if scene.get("published")}
    published = []
    for row in rows if scenes else ():
        if scene := scenes.get(row["scene"]):
            method = "slgaussian" if row["method"] == ours else row["method"]
            frame = f"{row['scene']}/{row['frame']}"  # two pairs may share a target frame
            names = {"dataset": scene["format"], "scene": scene["scene"], "method": method}
            published.append({**row, **names, "frame": frame})
    scores = {}
    for row in score_table(published).to_pylist():  # of all scenes of a data set
        scores[row["dataset"], None, *_score_key(row)] = row
    for dataset, scene in {(row["dataset"], row["scene"]) for row in published}:
        of_scene = [r for r in published if (r["dataset"], r["scene"]) == (dataset, scene)]
        for row in score_table(of_scene).to_pylist():
            scores[dataset, scene, *_score_key(row)] = row
    protocols = [name for name in PROTOCOLS if any(key[3] == name for key in scores)]
    blocks: list[Block] = [Prose(INTRODUCTION)]
    for protocol in protocols:
        for table in TABLES:
            used = {column.get("protocol", protocol) for column in table["columns"]}
            settings = {
                f"{score['protocol']} ({conditions(score)})"
                for key, score in scores.items()
                if key[3] in used
            }
            notes = [f"This run: {escape('; '.join(sorted(settings)))}."]
            blocks.append(_table(table, scores, protocol, ours, notes))
    return Section("The paper's tables", blocks, "paper") if protocols else None


def _score_key(score: Row) -> tuple[str, str, str]:
    return score["method"], score["protocol"].partition("@")[0], score["metric"]


def _table(
    table: Mapping[str, Any],
    scores: Mapping[tuple[Any, ...], Row],
    protocol: str,
    ours: str,
    notes: Sequence[str],
) -> Table:
    titles = [line["title"] for line in table["lines"]]

    def make_title(entry: Mapping[str, Any]) -> str:
        title, method = entry["title"].replace("_", " "), entry.get("method")
        return f"{title} / {ours if method == 'slgaussian' else method}" if method else title

    rows = []
    for line in table["lines"]:
        cells = []
        for column, printed in zip(table["columns"], line["numbers"], strict=True):
            cell = {"protocol": protocol, **table, **line, **column}
            all_scenes = titles[:-1] if line["title"] == "overall" else [line["title"]]
            scenes = cell.get("scenes", all_scenes)
            of = cell.get("method", ""), cell["protocol"], cell["metric"]
            present = all((cell["format"], scene, *of) in scores for scene in scenes)
            key = cell["format"], scenes[0] if len(scenes) == 1 else None, *of
            text = f"{printed:g}" if cell["metric"] == "seconds" else f"{printed:.2f}"
            cells.append(Cell(text, _number(scores[key]) if present else ""))
        rows.append([make_title(line), *cells])
    heads = ["", *map(make_title, table["columns"])]
    return Table(heads, rows, table["title"], notes, has_total=titles[-1] == "overall")


def _number(score: Row) -> str:
    """Format a score, %, with its interval and the number of samples."""
    bounds = [score["low"], score["high"]]
    interval = "" if None in bounds else f" ({100 * bounds[0]:.2f}–{100 * bounds[1]:.2f})"
    return f"{100 * score['value']:.2f}{interval}, n {score['samples']}"
