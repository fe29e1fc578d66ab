"""Compare runs: text for the terminal, and a page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from flows.cli.tables import gains_table
from flows.cli.text import aligned
from slgaussian.benchmark.comparison import (
    compare_reports,
    differing_settings,
    read_made,
    render_comparison,
)
from slgaussian.benchmark.outputs import write_file
from slgaussian.benchmark.run_ranking import rank_methods, render_ranking
from slgaussian.errors import InputError


def compare(folders: Sequence[Path], out: Path | None) -> str:
    """Compare two runs, the second minus the first, or rank the methods of more of them.

    With ``out``, ``compare.html`` and ``compare.md`` are written there.

    Raises
    ------
    InputError
        If a folder is none that a run left, or the pages cannot be written.
    """
    if len(folders) < 2:
        raise InputError(f"compare: found {len(folders)} run, expected two or more")
    first, *others = runs = [read_made(folder) for folder in folders]
    if len(runs) == 2:
        comparison = compare_reports(*runs)
        blocks = [comparison.said]
        if comparison.settings:
            blocks.append(_changes("differs:", comparison.settings))
        blocks += map(gains_table, comparison.tables)
        if comparison.costs:
            blocks.append(_changes("cost:", comparison.costs))
        if comparison.changes:
            queries = [
                f"  {change.first:.3f} -> {change.second:.3f}  {change.row['query']} "
                f"({change.row['scene']}, {change.row['frame']})"
                for change in comparison.changes
            ]
            blocks.append("\n".join(["IoU that changed most:", *queries]))
        pages = render_comparison(comparison)
    else:
        rankings = rank_methods(runs)
        differences = {
            str(run.folder): settings
            for run in others
            if (settings := differing_settings(first.manifest, run.manifest))
        }
        blocks = [f"{one.title}\n{aligned([one.header, *one.rows])}" for one in rankings]
        for folder, settings in differences.items():
            blocks.append(_changes(f"{folder} differs from {first.folder}:", settings))
        pages = render_ranking(rankings, differences)
    if out is not None:
        for suffix, text in zip(("html", "md"), pages, strict=True):
            write_file(out / f"compare.{suffix}", text.encode())
        blocks.append(f"page: {out / 'compare.html'}")
    return "\n\n".join(blocks)


def _changes(title: str, changes: Iterable[tuple[str, str, str]]) -> str:
    return "\n".join([title, *(f"  {name}: {one} -> {other}" for name, one, other in changes)])
