"""Settings as command-line options, so that a setting is described and checked in one place."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import typer

from flows.settings import Settings


def with_options(*names: str) -> Callable[[Callable], Callable]:
    """Give a command an option for each named setting.

    Those that the user set arrive as one dict in the parameter ``settings``; the others are left
    out of it, so that defaults and configuration files have their say.
    """

    def decorate(command: Callable) -> Callable:
        own = inspect.signature(command)
        kept = [p for p in own.parameters.values() if p.name != "settings"]

        @functools.wraps(command)
        def wrapper(**values: Any) -> Any:
            chosen = {name: values.pop(name) for name in names}
            chosen = {name: value for name, value in chosen.items() if value is not None}
            return command(**values, settings=chosen)

        extra = [_option(name) for name in names]
        wrapper.__signature__ = own.replace(parameters=[*kept, *extra])
        hints = {p.name: p.annotation for p in (*kept, *extra)}
        wrapper.__annotations__ = {**hints, "return": None}
        return wrapper

    return decorate


def _option(name: str) -> inspect.Parameter:
    field = Settings.model_fields[name]
    kind = {int: int, float: float, float | None: float}.get(field.annotation, str)
    default_text = "" if field.default is None else f" [default: {field.default}]"
    help_text = field.description + default_text
    flag = f"--{name.replace('_', '-')}"
    default = typer.Option(None, flag, help=help_text, show_default=False)
    kind_or_none = kind | None
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind_or_none
    )
