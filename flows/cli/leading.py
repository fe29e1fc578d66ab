"""Methods of several runs ranked: text for the terminal, and a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flows.cli.tables import aligned
from slgaussian.benchmark.leaderboard import (
    Board,
    Entry,
    Leaderboard,
    read_leaderboard,
    render_leaderboard,
)
from slgaussian.benchmark.outputs import write_file


def leaderboard(folders: Sequence[Path], out: Path | None) -> str:
    """Rank what runs left in folders; what is to be said of it.

    With ``out``, ``leaderboard.html`` and ``leaderboard.md`` are written there.

    Raises
    ------
    InputError
        If a folder is none that a run left, or the pages cannot be written.
    """
    found = read_leaderboard(folders)
    blocks = [_runs(found), *map(_board, found.boards)]
    if out is not None:
        for name, text in zip(("html", "md"), render_leaderboard(found), strict=True):
            write_file(out / f"leaderboard.{name}", text.encode())
        blocks.append(f"page: {out / 'leaderboard.html'}")
    return "\n\n".join(blocks)


def _runs(found: Leaderboard) -> str:
    return "\n".join(
        f"{folder.letter}  {folder.path}  version {folder.version}  {folder.machine}"
        for folder in found.folders
    )


def _board(board: Board) -> str:
    """The first score of each method, with its interval; all of them are in the page."""
    first = board.columns[0].title
    blocks = [f"{board.dataset} by {board.protocol} at {board.size}"]
    for ranking in board.rankings:
        rows = [["", "method", "run", first, "s"]]
        rows += [_line(entry) for entry in ranking.entries]
        marks = dict.fromkeys(
            f"{entry.folder.letter} differs: {mark}"
            for entry in ranking.entries
            for mark in entry.marks
        )
        blocks.append("\n".join([ranking.said, aligned(rows), *marks]))
    return "\n".join(blocks)


def _line(entry: Entry) -> list[str]:
    cell, seconds = entry.cells[0], entry.cost and entry.cost.view_query
    value = f"{cell.value} ({cell.interval})" if cell.interval else cell.value
    spent = "–" if seconds is None else f"{seconds:.3f}"
    return [str(entry.rank), entry.method, entry.folder.letter, value, spent]
