"""Every component with its fields, from their configs: as text, as the page of docs."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

from slgaussian.components.config import expected
from slgaussian.components.registry import KINDS, find_config, names_of
from slgaussian.errors import InputError

HEAD = """# Components and their fields

Made by `python docs/make_components.py` from what the components declare. `slgaussian doctor
--components` says the same of an installation, with the components of other packages.

A field such as `depth_candidates` of `planesweep` is `--set planesweep.depth_candidates=64` on the
command line, `depth_candidates` in the table `[planesweep]` of a configuration file (the table of
`sam2-video` is `[sam2_video]`), and in Python
`slg.Method(settings={"planesweep": {"depth_candidates": 64}})`. A file, folder or model is known by
its content in cache keys and results, wherever it is. How a component is added:
[architecture](../architecture.md#where-to-add-a-part)."""


def catalogue() -> Iterator[dict[str, Any]]:
    """Yield kind, name, a sentence and fields of every component; the problem of an unusable one.

    A field has ``name``, ``default``, ``help``, ``expected`` (its values in words) and whether it
    is a ``file``.
    """
    for kind in KINDS:
        for name in names_of(kind):
            try:
                config = find_config(kind, name)
            except InputError as error:
                yield {"kind": kind, "name": name, "about": "", "problem": str(error), "fields": []}
                continue
            fields = [
                {
                    "name": key,
                    "default": field.default,
                    "help": field.description or "",
                    "expected": expected(config, key),
                    "file": key in config.files(),
                }
                for key, field in config.model_fields.items()
            ]
            yield {"kind": kind, "name": name, "about": _sentence(config), "fields": fields}


def as_text() -> str:
    """Return the components for a terminal, under the heading of their kind."""
    lines, components = [], list(catalogue())
    for kind, known in KINDS.items():
        lines += ["", f"{kind}: {known.help}"]
        for each in (each for each in components if each["kind"] == kind):
            lines.append(f"  {each['name']}: {each.get('problem') or each['about']}")
            for field in each["fields"]:
                key = f"{each['name']}.{field['name']}".replace("-", "_")
                default = "" if field["default"] is None else f" [{field['default']}]"
                lines.append(f"    {key} <{field['expected']}>{default}  {field['help']}")
    return "\n".join(lines[1:])


def as_markdown() -> str:
    """Return the page of the documentation."""
    text, components = [HEAD], list(catalogue())
    for kind, known in KINDS.items():
        text.append(f"## {kind.capitalize()}\n\n{known.help}")
        for each in (each for each in components if each["kind"] == kind):
            default = " (default)" if each["name"] == known.default else ""
            text.append(f"### {each['name']}{default}\n\n{each['about']}")
            rows = ["| field | value | default | |", "| --- | --- | --- | --- |"]
            for field in each["fields"]:
                default = "" if field["default"] is None else f"`{field['default']}`"
                rows.append(
                    f"| `{field['name']}` | {field['expected']} | {default} | {field['help']} |"
                )
            text += ["\n".join(rows)] if each["fields"] else []
    return "\n\n".join(text) + "\n"


def _sentence(config: type) -> str:
    """Return the first sentence of a docstring, without markup."""
    first = (inspect.getdoc(config) or "").split("\n\n")[0].replace("\n", " ")
    plain = re.sub(r":\w+:`[~\w.]*?(\w+)`", r"\1", first).replace("``", "`")
    return plain.split(". ")[0].rstrip(".") + "."
