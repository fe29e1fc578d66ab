"""Lines that stay and, on a terminal, a small table below them that is always up to date."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterable, Sequence
from typing import TextIO

from rich.cells import cell_len, set_cell_size

from slgaussian.errors import one_line

GAP, LEAST = 2, 7
"""Columns between two cells, and of a cell at least: its value grows, and those beside it stay."""

PATIENCE = 15.0
"""Seconds between lines that say what is waited for, where there is no terminal."""

FAINT, PLAIN = "\x1b[2m", "\x1b[0m"


class Display:
    """A stream to write to; ``live`` says whether it is a terminal that keeps a table.

    The table is drawn where the cursor is, and the cursor left at its end. So what is left of it
    when the program is killed is a few lines, and the terminal as it was.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        self.live = stream.isatty() and os.environ.get("TERM") != "dumb"
        self.drawn = 0

    def line(self, text: str) -> None:
        """A line that stays, or several; what a terminal would obey is shown, not done."""
        safe = "\n".join(map(one_line, text.split("\n")))
        self.stream.write(f"{self._gone()}{safe}\n")
        self.stream.flush()

    def table(self, cells: Iterable[tuple[str, str]], below: str) -> None:
        """Draw the table anew: a heading and a value a column, and a line below."""
        columns, lines = self._size()
        rows = [*wrapped(list(cells), columns - 1), ("", below)]
        text = [
            f"{mark}{cut(line, columns - 1)}{PLAIN if mark else ''}"
            for labels, values in rows
            for mark, line in ((FAINT, labels), ("", values))
            if line
        ][: lines - 1]
        self.stream.write(self._gone() + "\n".join(text))
        self.stream.flush()
        self.drawn = len(text)

    def clear(self) -> None:
        """Take the table away."""
        self.stream.write(self._gone())
        self.stream.flush()

    def _gone(self) -> str:
        up = f"\x1b[{self.drawn - 1}A" if self.drawn > 1 else ""
        gone = f"\r{up}\x1b[J" if self.drawn else ""
        self.drawn = 0
        return gone

    def _size(self) -> os.terminal_size:
        try:
            found = os.get_terminal_size(self.stream.fileno())
        except (OSError, ValueError):
            return shutil.get_terminal_size()
        return found if min(found) > 0 else shutil.get_terminal_size()


class Waiting:
    """What a command waits for: a line that goes away on a terminal, elsewhere one now and then."""

    def __init__(self, stream: TextIO) -> None:
        self.display, self.said = Display(stream), -PATIENCE

    def __call__(self, text: str) -> None:
        """What is waited for now; an empty text when that is over."""
        now = time.monotonic()
        if not text:
            self.display.clear()
        elif self.display.live:
            self.display.table([], text)
        elif now - self.said >= PATIENCE:
            self.said = now
            self.display.line(text)


def wrapped(cells: Sequence[tuple[str, str]], width: int) -> list[tuple[str, str]]:
    """Cells as rows of headings and values, each as many as the width has room for."""
    rows = []
    labels = values = ""
    for label, value in cells:
        wide = max(LEAST, cell_len(label), cell_len(value))
        if labels and cell_len(labels) + wide > width:
            rows.append((labels.rstrip(), values.rstrip()))
            labels = values = ""
        labels += set_cell_size(label, wide + GAP)
        values += set_cell_size(value, wide + GAP)
    return [*rows, (labels.rstrip(), values.rstrip())]


def cut(text: str, width: int) -> str:
    """Text that takes at most so many columns, with what a terminal would obey escaped."""
    safe = one_line(text)
    if cell_len(safe) <= width:
        return safe
    return set_cell_size(safe, max(0, width - 1)).rstrip() + "…"
