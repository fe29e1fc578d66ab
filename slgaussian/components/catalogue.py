"""Every component with its fields, described from their configs."""

from __future__ import annotations

import inspect
import re

from slgaussian.components.config import ComponentConfig, expected
from slgaussian.components.registry import KINDS, find_config, names_of
from slgaussian.errors import InputError


def list_components() -> str:
    """Return all components with their fields, or their import error, as Markdown."""
    text = []
    for kind, group in KINDS.items():
        text.append(f"## {kind.capitalize()}\n\n{group.help}")
        for name in names_of(kind):
            default = " (default)" if name == group.default else ""
            text.append(f"### {name}{default}")
            try:
                config = find_config(kind, name)
            except InputError as error:
                text.append(str(error))
                continue
            text.append(_first_sentence(config))
            fields = []
            for key, field in config.model_fields.items():
                default = "" if field.default is None else f"; default `{field.default}`"
                fields.append(f"- `{key}`: {expected(config, key)}{default}. {field.description}")
            text += ["\n".join(fields)] if fields else []
    return "\n\n".join(text) + "\n"


def _first_sentence(config: type[ComponentConfig]) -> str:
    """Return the first sentence of a docstring, without markup."""
    first = (inspect.getdoc(config) or "").split("\n\n")[0].replace("\n", " ")
    plain = re.sub(r":\w+:`[~\w.]*?(\w+)`", r"\1", first).replace("``", "`")
    return plain.split(". ")[0].rstrip(".") + "."
