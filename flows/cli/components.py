"""List every part with its settings, from what the parts declare."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slgaussian.errors import InputError
from slgaussian.parts.registry import KINDS, find_part, names_of
from slgaussian.parts.settings import Setting, settings_of

TYPES = {bool: "yes or no", int: "whole number", float: "number", str: "text", Path: "path"}


def catalogue() -> Iterator[dict[str, Any]]:
    """Kind, name, a sentence and settings of every part; of one that cannot be used, why not."""
    for kind in KINDS:
        for name in names_of(kind):
            try:
                part = find_part(kind, name)
            except InputError as error:
                yield {"kind": kind, "name": name, "about": "", "problem": str(error)}
                continue
            settings = [_row(setting) for setting in settings_of(part).values()]
            yield {"kind": kind, "name": name, "about": _sentence(part), "settings": settings}


def listed() -> str:
    """The parts as text for a terminal, under the heading of their kind."""
    lines: list[str] = []
    for kind, parts in _by_kind().items():
        lines += ["", f"{kind}: {KINDS[kind].help}"]
        for part in parts:
            lines.append(f"  {part['name']}: {part.get('problem') or part['about']}")
            for row in part.get("settings", ()):
                key = f"{part['name'].replace('-', '_')}.{row['name']}"
                default = "" if row["default"] is None else f" [{row['default']}]"
                lines.append(f"    {key} <{_type(row)}>{default}  {row['help']}")
    return "\n".join(lines[1:])


def markdown() -> str:
    """The page `docs/reference/parts.md`."""
    text = [
        "# Parts and their settings",
        """Made by `python docs/make_parts.py` from what the parts declare. `slgaussian doctor
--components` says the same of an installation, with the parts of other packages.

A setting such as `depth_candidates` of `planesweep` is `--set planesweep.depth_candidates=64` on
the command line, `depth_candidates` in the table `[planesweep]` of a configuration file (the table
of `sam2-video` is `[sam2_video]`), and in Python
`slg.Method(settings={"planesweep": {"depth_candidates": 64}})`. A file, folder or model is known by
its content in cache keys and results, wherever it is. How a part is added:
[architecture](../architecture.md#where-to-add-a-part).""",
    ]
    for kind, parts in _by_kind().items():
        text.append(f"## {kind.capitalize()}\n\n{KINDS[kind].help}")
        for part in parts:
            default = " (default)" if part["name"] == KINDS[kind].default else ""
            text.append(f"### {part['name']}{default}\n\n{part['about']}")
            if part["settings"]:
                rows = ["| setting | value | default | |", "| --- | --- | --- | --- |"]
                for row in part["settings"]:
                    default = "" if row["default"] is None else f"`{row['default']}`"
                    rows.append(f"| `{row['name']}` | {_type(row)} | {default} | {row['help']} |")
                text.append("\n".join(rows))
    return "\n\n".join(text) + "\n"


def schema() -> str:
    """The JSON schema of a configuration file of `slgaussian run`."""
    from flows.settings import Settings

    return json.dumps(Settings.model_json_schema(), indent=1)


def _by_kind() -> dict[str, list[dict[str, Any]]]:
    found: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    for part in catalogue():
        found[part["kind"]].append(part)
    return found


def _row(setting: Setting) -> dict[str, Any]:
    """A setting as plain values; bounds and choices only where there are some."""
    is_file = setting.content is not None
    names = [TYPES[m] for m in setting.members if m in TYPES and (m is not Path or setting.is_path)]
    bounds = {"low": setting.low, "high": setting.high, "choices": list(setting.choices) or None}
    return {
        "name": setting.name,
        "type": "path or name" if is_file and not setting.is_path else names[0],
        "words": list(setting.words),
        "default": setting.default,
        **{name: bound for name, bound in bounds.items() if bound is not None},
        "file": is_file,
        "help": setting.help,
    }


def _type(row: dict[str, Any]) -> str:
    """What a value is, and how large it may be."""
    if "choices" in row:
        return ", ".join(row["choices"])
    low, high = row.get("low"), row.get("high")
    bounds = f" {low} to {high}" if None not in (low, high) else ""
    if not bounds and low is not None:
        bounds = f" from {low}"
    return " or ".join([row["type"] + bounds, *row["words"]])


def _sentence(part: Any) -> str:
    """The first sentence of the docstring of a part, without markup."""
    first = (inspect.getdoc(part) or "").split("\n\n")[0].replace("\n", " ")
    plain = re.sub(r":\w+:`[~\w.]*?(\w+)`", r"\1", first).replace("``", "`")
    return plain.split(". ")[0].rstrip(".") + "."
