"""Tables in a terminal, without the imports of a report."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

import rich.console
import rich.table

UNBOUNDED_WIDTH = 10_000
"""Width of tables that are not wrapped."""


def table_text(rows: Iterable[Sequence[str]], sides: str = "<", wrap: bool = True) -> str:
    """Return rows of cells, with the header first, as text in columns two spaces apart.

    ``sides`` has the alignment of each column, ``<`` (left) or ``>`` (right, the default). Cells
    are wrapped to the width of the terminal if ``wrap`` and standard output is one.
    """
    header, *body = rows
    table = rich.table.Table(box=None, pad_edge=False)
    for title, side in zip(header, sides.ljust(len(header), ">"), strict=True):
        table.add_column(title, justify="left" if side == "<" else "right")
    for cells in body:
        table.add_row(*cells)
    width = None if wrap and sys.stdout.isatty() else UNBOUNDED_WIDTH
    console = rich.console.Console(width=width, markup=False, emoji=False, highlight=False)
    with console.capture() as text:
        console.print(table)
    return "\n".join(line.rstrip() for line in text.get().splitlines())
