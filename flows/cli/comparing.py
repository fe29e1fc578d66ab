"""Two report folders compared: text for the terminal, and a page."""

from __future__ import annotations

from pathlib import Path

from flows.cli.tables import gains_table
from slgaussian.benchmark.comparison import (
    Reports,
    compare_reports,
    read_made,
    render_comparison,
)
from slgaussian.benchmark.outputs import write_file


def compare(first: Path, second: Path, out: Path | None) -> str:
    """Compare what two runs left, ``second`` minus ``first``; what is to be said of it.

    With ``out``, ``compare.html`` and ``compare.md`` are written there.

    Raises
    ------
    InputError
        If a folder is none that a run left, or the pages cannot be written.
    """
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
