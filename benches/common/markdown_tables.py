"""Rows of numbers as Markdown tables that read well in a terminal too."""

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """The form of a table: its title, and what a reader must know to read it.

    ``columns`` says for each key of the rows what its heading is and how it is printed; a row
    without the key has an empty cell there.
    """

    title: str
    about: str
    columns: dict[str, tuple[str, Callable]]

    def markdown(self, rows: list[dict]) -> str:
        heads = [heading for heading, _ in self.columns.values()]
        cells = [
            [show(row[key]) if key in row else "" for key, (_, show) in self.columns.items()]
            for row in rows
        ]
        widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
        right = [show is not str for _, show in self.columns.values()]
        rule = ["-" * (width - r) + ":" * r for width, r in zip(widths, right, strict=True)]
        lines = [
            [
                cell.rjust(width) if r else cell.ljust(width)
                for cell, width, r in zip(line, widths, right, strict=True)
            ]
            for line in [heads, rule, *cells]
        ]
        table = [f"| {' | '.join(line)} |" for line in lines]
        return "\n".join([f"## {self.title}", "", self.about, "", *table, ""])


def count(value: float) -> str:
    return f"{value:,.0f}"


def hundredths(value: float) -> str:
    return f"{value:.2f}"


def thousandths(value: float) -> str:
    return f"{value:.3f}"


def ms(seconds: float) -> str:
    """Milliseconds to three digits, or all before the point."""
    value = 1e3 * seconds
    decimals = 2 - math.floor(math.log10(value)) if value > 0 else 0
    return f"{value:,.{max(0, min(decimals, 2))}f}"


def error(value: float) -> str:
    return f"{value:.1e}".replace("e-0", "e-") if value else "0"


def error_under(bound: float) -> Callable[[float], str]:
    """Like :func:`error`, in bold unless it is below ``bound``."""
    return lambda value: error(value) if value < bound else f"**{error(value)}**"


def fraction(value: float) -> str:
    """As one over a whole number."""
    return f"1/{1 / value:.0f}" if value else "0"


def limit(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:g}"
