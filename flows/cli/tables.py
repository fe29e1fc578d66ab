"""Tables for a terminal, or for a pipe with each row in a line."""

import sys
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

UNBOUNDED = 10_000
"""Columns of characters of what is no terminal."""


def table_text(rows: Iterable[Sequence[str]], sides: str = "<") -> str:
    """Return rows of cells, the first of which is the header, as text in columns.

    ``sides`` has ``<`` (left) or ``>`` (right) for each column; those that it does not name are to
    the right.
    """
    header, *body = rows
    table = Table(box=None, pad_edge=False)
    for title, side in zip(header, sides.ljust(len(header), ">"), strict=True):
        table.add_column(title, justify="left" if side == "<" else "right")
    for cells in body:
        table.add_row(*cells)
    width = None if sys.stdout.isatty() else UNBOUNDED
    console = Console(width=width, markup=False, emoji=False, highlight=False)
    with console.capture() as text:
        console.print(table)
    return "\n".join(line.rstrip() for line in text.get().splitlines())
