"""Settings as command-line options, so that a setting is described and checked in one place."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from copy import copy
from typing import Any

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from flows.settings import TABLES, Settings


def with_options(*names: str, of: type[BaseModel] = Settings) -> Callable[[Callable], Callable]:
    """Give a command an option for each named setting, and for each key of one that is a table.

    The settings are those of the model ``of``. A name such as ``clip.model`` stands for one key of
    a table, whose default is not said.

    Those that the user set arrive as one dict in the parameter ``settings``, as a configuration
    file would have them; the others are left out of it, so that defaults and such files have their
    say.
    """
    fields = {}
    for name in names:
        if name in TABLES:
            for key, field in TABLES[name].model_fields.items():
                fields[name, key] = field
        elif "." in name:
            table, key = name.split(".")
            fields[table, key] = copy(TABLES[table].model_fields[key])
            fields[table, key].default = None
        else:
            fields[name,] = of.model_fields[name]

    def decorate(command: Callable) -> Callable:
        own = inspect.signature(command)
        kept = [p for p in own.parameters.values() if p.name != "settings"]

        @functools.wraps(command)
        def wrapper(**values: Any) -> Any:
            chosen: dict[str, Any] = {}
            for path in fields:
                value = values.pop("_".join(path))
                if value is not None:
                    table = chosen.setdefault(path[0], {}) if len(path) > 1 else chosen
                    table[path[-1]] = value
            return command(**values, settings=chosen)

        extra = [_option("_".join(path), field) for path, field in fields.items()]
        wrapper.__signature__ = own.replace(parameters=[*kept, *extra])
        hints = {p.name: p.annotation for p in (*kept, *extra)}
        wrapper.__annotations__ = {**hints, "return": None}
        return wrapper

    return decorate


def _option(name: str, field: FieldInfo) -> inspect.Parameter:
    kind = {int: int, float: float, float | None: float}.get(field.annotation, str)
    value = field.default
    shown = "x".join(map(str, value)) if isinstance(value, tuple) else value
    default_text = "" if value is None else f" [default: {shown}]"
    help_text = field.description + default_text
    flag = f"--{name.replace('_', '-')}"
    default = typer.Option(None, flag, help=help_text, show_default=False)
    kind_or_none = kind | None
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind_or_none
    )
