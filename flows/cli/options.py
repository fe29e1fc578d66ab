"""Settings as command-line options, so that a setting is described and checked in one place."""

from __future__ import annotations

import functools
import inspect
import pkgutil
from collections.abc import Callable, Collection, Sequence
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import typer

from slgaussian.parts.registry import KINDS, names_of

if TYPE_CHECKING:  # `--help` names the commands, and waits for no model
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo

Names = str | Callable[[], Collection[str]]
"""A setting; or a function that names several, which is called when the command is looked at."""


def with_options(
    *names: Names, of: str = "flows.settings:Settings", common: Collection[str] | None = None
) -> Callable[[Callable], Callable]:
    """Give a command an option for each named setting, and for each key of one that is a table.

    The settings are those of the model ``of``, as ``module:name``, all of them if none is named.
    The command gets its options when it is first looked at, and only then models are imported:
    :class:`flows.cli.help.Command` asks its function :data:`LATER` for them.

    A name such as ``clip.model`` stands for one key of a table, whose default is not said. Those
    that are not ``common`` get a heading in the help; otherwise all are common.

    Those that the user set arrive as one dict in the parameter ``settings``, as a configuration
    file would have them; the others are left out of it, so that defaults and such files have their
    say.
    """

    def decorate(command: Callable) -> Callable:
        def made() -> Callable:
            return _with_options(command, names, pkgutil.resolve_name(of), common)

        setattr(command, LATER, made)
        return command

    return decorate


LATER = "with_its_options"
"""The attribute of a command that makes it one with its options."""


def _with_options(
    command: Callable, names: Sequence[Names], of: type[BaseModel], common: Collection[str] | None
) -> Callable:
    from flows.settings import TABLES

    named = [n for name in names for n in ([name] if isinstance(name, str) else name())]
    fields: dict[tuple[str, ...], FieldInfo] = {}
    for name in named or of.model_fields:
        if name in TABLES:
            for key, field in TABLES[name].model_fields.items():
                fields[name, key] = field
        elif "." in name:
            table, key = name.split(".")
            fields[table, key] = copy(TABLES[table].model_fields[key])
            fields[table, key].default = None
        else:
            fields[name,] = of.model_fields[name]

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

    extra = []
    for path, field in fields.items():
        rare = common is not None and ".".join(path) not in common
        extra.append(_option(path, field, _heading(path, of) if rare else None))
    wrapper.__signature__ = own.replace(  # type: ignore[attr-defined]  # inspect looks for it
        parameters=[*kept, *extra]
    )
    hints = {p.name: p.annotation for p in (*kept, *extra)}
    wrapper.__annotations__ = {**hints, "return": None}
    return wrapper


def _option(path: tuple[str, ...], field: FieldInfo, heading: str | None) -> inspect.Parameter:
    from pydantic_core import PydanticUndefined

    from flows.encoder_choice import AUTO

    name = "_".join(path)
    kinds: dict[Any, type] = {bool: bool, int: int, float: float}
    kinds |= {int | None: int, float | None: float}
    kind = kinds.get(field.annotation, str)
    help_text = field.description or ""
    literal = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    choices: Sequence[str] = field.examples or literal
    if name in KINDS and not choices:
        choices = (*names_of(name), *((AUTO,) if name == "encoder" else ()))
        help_text = f"{help_text.removesuffix('.')}: {_listed(choices)}."
    value = field.default
    if value is not None and value is not False and value is not PydanticUndefined:
        shown = "x".join(map(str, value)) if isinstance(value, tuple) else value
        help_text += f" [default: {shown}]"
    metavar = "<path>" if field.annotation in (Path, Path | None) else "<name>" if choices else None
    default = typer.Option(
        None,
        f"--{name.replace('_', '-')}",
        help=help_text,
        show_default=False,
        metavar=metavar,
        autocompletion=(lambda: choices) if choices else None,
        rich_help_panel=heading,
    )
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind | None
    )


def _heading(path: tuple[str, ...], of: type[BaseModel]) -> str:
    """Which part a key of a table belongs to, or what the model that declares a setting is of."""
    if len(path) > 1:
        part = path[0].replace("_", "-")
        kind = next(kind for kind in KINDS if part in names_of(kind))
        return f"{kind.capitalize()} {part}"
    owner: Any = next(c for c in of.__mro__ if path[0] in inspect.get_annotations(c))
    return owner.model_config["title"]


def _listed(names: Sequence[str]) -> str:
    return " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
