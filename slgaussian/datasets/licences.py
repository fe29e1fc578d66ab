"""Licences of data, from the licence files next to them."""

from __future__ import annotations

from pathlib import Path

NAMES = ("LICENSE*", "LICENCE*", "COPYING*", "COPYRIGHT*")
"""Name patterns of licence files."""

LONGEST = 80
"""Largest number of characters quoted from a line."""


def stated(path: Path) -> str:
    """List the licence files in a folder, or next to a file, each with its first line."""
    folder = path if path.is_dir() else path.parent
    statements = []
    for file in sorted({file for pattern in NAMES for file in folder.glob(pattern)}):
        try:
            lines = file.read_text("utf-8", "replace").split("\n")
        except OSError:
            continue
        first = next((line.strip() for line in lines if line.strip()), "")
        statements.append(f"{file.name}: {first[:LONGEST]}")
    return "; ".join(statements)
