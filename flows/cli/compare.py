"""Runs compared: text for the terminal, and a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flows.cli.tables import aligned, gains_table
from slgaussian.benchmark.comparison import (
    Reports,
    compare_reports,
    differing_settings,
    read_made,
    render_comparison,
)
from slgaussian.benchmark.outputs import write_file
from slgaussian.benchmark.run_ranking import rank_methods, render_ranking
from slgaussian.errors import InputError


def compare(runs: Sequence[Path], out: Path | None) -> str:
    """Compare two runs, the second minus the first, or rank the methods of more of them.

    With ``out``, ``compare.html`` and ``compare.md`` are written there.

    Raises
    ------
    InputError
        If a folder is none that a run left, or the pages cannot be written.
    """
    if len(runs) < 2:
        raise InputError(f"compare: found {len(runs)} run, expected two or more")
    if len(runs) > 2:
        return _ranked(runs, out)
    first, second = runs
    found = compare_reports(read_made(first), read_made(second))
    blocks = [_settings(found)] if found.settings else []
    blocks += [gains_table(table) for table in found.tables]
    if found.costs:
        blocks.append(_costs(found))
    if found.changes:
        blocks.append(_changes(found))
    if out is not None:
        for name, text in zip(("html", "md"), render_comparison(found), strict=True):
            write_file(out / f"compare.{name}", text.encode())
        blocks.append(f"page: {out / 'compare.html'}")
    return "\n\n".join([found.said, *blocks])


def _ranked(folders: Sequence[Path], out: Path | None) -> str:
    first, *others = runs = [read_made(folder) for folder in folders]
    rankings = rank_methods(runs)
    differences = {
        str(run.folder): found
        for run in others
        if (found := differing_settings(first.manifest, run.manifest))
    }
    blocks = [f"{one.title}\n{aligned([one.header, *one.rows])}" for one in rankings]
    for folder, settings in differences.items():
        lines = [f"  {name}: {one} -> {other}" for name, one, other in settings]
        blocks.append("\n".join([f"{folder} differs from {first.folder}:", *lines]))
    if out is not None:
        for name, text in zip(("html", "md"), render_ranking(rankings, differences), strict=True):
            write_file(out / f"compare.{name}", text.encode())
        blocks.append(f"page: {out / 'compare.html'}")
    return "\n\n".join(blocks)


def _settings(found: Reports) -> str:
    return "\n".join(
        ["differs:", *(f"  {name}: {one} -> {other}" for name, one, other in found.settings)]
    )


def _costs(found: Reports) -> str:
    return "\n".join(
        ["cost:", *(f"  {name}: {one} -> {other}" for name, one, other in found.costs)]
    )


def _changes(found: Reports) -> str:
    lines = [
        f"  {change.first:.3f} -> {change.second:.3f}  {change.row['query']} "
        f"({change.row['scene']}, {change.row['frame']})"
        for change in found.changes
    ]
    return "\n".join(["IoU that changed most:", *lines])
