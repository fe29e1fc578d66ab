"""Plain text for a terminal or a pipe."""

from collections.abc import Sequence


def aligned(rows: Sequence[Sequence[str]], sides: str = "<") -> str:
    """Return lines of cells in columns, two spaces apart.

    ``sides`` has ``<`` (left) or ``>`` (right) for each column; those that it does not name are to
    the right.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    formats = [
        f"{side}{width}" for side, width in zip(sides.ljust(len(widths), ">"), widths, strict=True)
    ]
    return "\n".join("  ".join(map(format, cells, formats)).rstrip() for cells in rows)
