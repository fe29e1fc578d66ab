"""Licences of data, as files beside them state them."""

from __future__ import annotations

from pathlib import Path

NAMES = ("LICENSE*", "LICENCE*", "COPYING*", "COPYRIGHT*")
"""Names of files that say what may be done with data."""

LONGEST = 80
"""Characters of a line that are quoted."""


def stated(path: Path) -> str:
    """List the licence files in a folder, or beside a file, each with its first line."""
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
