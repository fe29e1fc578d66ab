"""Rows of numbers as Markdown tables that read well in a terminal too."""

import math
from collections.abc import Callable, Mapping, Sequence

Show = str | Callable
"""How a value is printed: a format specification such as ``.2f``, or what makes a string of it."""


def show(value: object, how: Show) -> str:
    return how(value) if callable(how) else format(value, how)


def table(rows: Sequence[Mapping], columns: Mapping[str, tuple[str, Show]]) -> str:
    """A Markdown table of ``rows``.

    ``columns`` says for each key of the rows what its heading is and how it is printed; a row
    without the key has an empty cell there. Numbers are aligned on the right, ``str`` on the left.
    """
    heads = [heading for heading, _ in columns.values()]
    cells = [
        [show(row[key], how) if key in row else "" for key, (_, how) in columns.items()]
        for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    right = [how is not str for _, how in columns.values()]
    rule = ["-" * (width - r) + ":" * r for width, r in zip(widths, right, strict=True)]
    lines = [
        [
            cell.rjust(width) if r else cell.ljust(width)
            for cell, width, r in zip(line, widths, right, strict=True)
        ]
        for line in [heads, rule, *cells]
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ms(seconds: float) -> str:
    """Milliseconds to three digits, or all before the point."""
    value = 1e3 * seconds
    decimals = 2 - math.floor(math.log10(value)) if value > 0 else 0
    return f"{value:,.{max(0, min(decimals, 2))}f}"


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def tenths_of_percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def per_cent(share: float) -> str:
    """Of a column whose heading or text says the unit."""
    return f"{100 * share:.2f}"


def interval(ends: tuple[float, float]) -> str:
    return f"{ends[0]:+.3f} to {ends[1]:+.3f}"


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
