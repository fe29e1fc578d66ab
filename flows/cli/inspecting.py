"""What `slgaussian inspect` prints of a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slgaussian.storage.inspection import Inspected, Seen

LONGEST = 100
"""Characters of a setting that are printed."""


def told(found: Inspected) -> str:
    """What a file or folder holds, as text for a terminal."""
    return "\n".join(_lines(found))


def _lines(found: Inspected) -> Iterator[str]:
    rows = "" if found.rows is None else f", {found.rows:,} rows"
    yield f"{found.path}: {found.form}, {found.bytes:,} bytes{rows}"
    if found.meaning:
        yield found.meaning
    yield ""
    if found.spec:
        by = "" if found.stated else " (by its name: the file itself does not say)"
        yield f"spec      {found.spec}{by}"
    if not found.holds:
        yield f"check     {found.problem or 'it is what its spec says'}"
    elif found.problem:
        yield f"check     {found.problem}"
    if found.digest:
        yield f"digest    {found.digest}"
    yield from _made(found)
    for name in ("source", "licence"):
        if getattr(found, name):
            yield f"{name:<9} {getattr(found, name)}"
    if found.holds:
        yield from _table([_held(one, Path(found.path)) for one in found.holds])
    if found.fields:
        yield ""
        yield from _table([_row(seen) for seen in found.fields])
    if found.axes:
        yield ""
        yield from (f"axis {letter}    {said}" for letter, said in found.axes.items())


def _made(found: Inspected) -> Iterator[str]:
    made = dict(found.made)
    if not made:
        yield "made by   it does not say"
        return
    version = f" version {made['stage_version']}" if "stage_version" in made else ""
    by = [made.get("program", ""), f"{made['stage']}{version}" if "stage" in made else ""]
    yield f"made by   {', '.join(filter(None, by)) or 'settings alone are known'}"
    if made.get("of"):
        yield f"made of   {', '.join(f'{name} ({spec})' for name, spec in made['of'].items())}"
    for name, value in made.get("settings", {}).items():
        yield f"setting   {name}: {_short(value)}"
    if made.get("software"):
        told = ", ".join(f"{name} {version}" for name, version in made["software"].items())
        yield f"software  {told}"


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}... (all with --json)"


def _row(seen: Seen) -> list[str]:
    sizes = "" if seen.shape is None else f" [{', '.join(map(str, seen.shape))}]"
    empty = f", {seen.empty:,} empty" if seen.empty else ""
    values = "" if seen.low is None else f"{seen.low:.6g} to {seen.high:.6g}"
    return [
        seen.name,
        f"{seen.type}{sizes}",
        seen.unit,
        f"{values}{empty}".lstrip(", "),
        seen.meaning,
    ]


def _held(one: Inspected, folder: Path) -> list[str]:
    rows = "" if one.rows is None else f"{one.rows:,} rows"
    bad = next((held.problem for held in (one, *one.holds) if held.problem), "")
    name = str(Path(one.path).relative_to(folder))
    return [name, one.spec, rows, f"{one.bytes:,} bytes", bad and f"BAD: {bad}"]


def _table(rows: list[list[str]]) -> Iterator[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield "  ".join(cells).rstrip()
