"""Options of several commands, settings from options and ``--set``, and groups of commands."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import BaseModel
from typer.core import TyperGroup

from flows.config import Settings
from flows.forms import with_default
from slgaussian.errors import InputError

ENGINE = ("store", "runner", "workers", "refresh")
COMPONENTS = ("predictor", "proposer", "tracker")
LABELLED_SET = ("data", "pairs", "labels", "format", "rooms")
"""Fields that are options of several commands."""


def add_options(
    *names: str, model: type[BaseModel] = Settings
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add options for fields of a configuration to a command, and ``--set`` for its other fields.

    They are not passed to the function: :func:`settings_from` reads them from the context.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)

        @wraps(command)
        def call(**values: Any) -> None:
            command(**{name: values[name] for name in signature.parameters})

        added = {
            name: Annotated[_find_type(name, model), field_option(name, model)] for name in names
        }
        fields = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=option)
            for name, option in {**added, "set_": Set}.items()
        ]
        parameters = [*signature.parameters.values(), *fields]
        call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return call

    return decorate


def field_option(name: str, model: type[BaseModel] = Settings) -> Any:
    """Return the option for a field of a configuration, with its description and default."""
    field = model.model_fields[name]
    text, values = field.description or "", tuple(field.examples or ())
    return typer.Option(
        f"--{name.replace('_', '-')}",
        metavar=None if field.annotation is bool else f"<{name}>",
        help=with_default(text, None if field.is_required() else field.default),
        autocompletion=(lambda: list(values)) if values else None,
    )


def _find_type(name: str, model: type[BaseModel]) -> Any:
    """Return the type that the command line parses; the model validates the rest."""
    annotation = model.model_fields[name].annotation
    types = (bool, int, float, Path, list[str])
    return next((t for t in types if annotation in (t, t | None)), str) | None


Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="<key=value>",
        help="Another field of the configuration, such as clip.model=PATH; may be repeated.",
    ),
]
Store = Annotated[str | None, field_option("store")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for every stage.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

Photos = Annotated[list[str], typer.Argument(metavar="PHOTO", help="Photographs, or a folder.")]
Texts = Annotated[
    list[str] | None, typer.Argument(metavar="TEXT", help='Text to look for, as "red basket".')
]
Cameras = Annotated[
    Path | None,
    typer.Option(help="transforms.json, LLFF's, or a COLMAP folder. [default: estimated]"),
]
Folder = Annotated[Path, typer.Argument(metavar="FIELD", help="Folder of a field.")]
FieldOrGaussians = Annotated[
    Path, typer.Argument(metavar="FIELD|FILE", help="Field, or any 3DGS .ply or .spz.")
]
View = Annotated[str | None, typer.Option(help="Name or number from 0. [default: 0]")]
Views = Annotated[
    list[str] | None,
    typer.Option("--view", help="View, by name or number from 0; may be repeated. [default: 0]"),
]
CameraFile = Annotated[
    Path | None,
    typer.Option("--camera", "--cameras", help="JSON of a camera, or a transforms.json."),
]
Between = Annotated[
    tuple[str, str, float] | None,
    typer.Option(metavar="A B T", help="Interpolate views A and B; T from 0 (A) to 1 (B)."),
]
Picture = Annotated[Path | None, typer.Option("--out", "-o", help="Picture: .png or .jpg.")]


def settings_from(
    ctx: typer.Context, model: type[BaseModel] = Settings, **values: Any
) -> dict[str, Any]:
    """Return settings in the form of a configuration file, tables as nested dicts.

    They combine ``values``, the options of the command that are fields of ``model``, and texts
    ``KEY=VALUE`` or ``TABLE.KEY=VALUE`` of ``--set``. A value is parsed as TOML if it is valid
    TOML, else it is text.

    Raises:
        InputError: If a text has another form, or a key is given twice.
    """
    values |= {name: ctx.params[name] for name in model.model_fields.keys() & ctx.params.keys()}
    values = {name: value for name, value in values.items() if value not in (None, [], ())}
    for assignment in ctx.params.get("set_") or ():
        key, equals, text = assignment.partition("=")
        *tables, name = key.strip().split(".")
        if not equals or not all([*tables, name]):
            raise InputError(
                f"--set: found {assignment!r}, expected KEY=VALUE, as "
                "planesweep.depth_candidates=96"
            )
        inner: Any = values
        for table in tables:
            inner = inner.setdefault(table, {}) if isinstance(inner, dict) else None
        if not isinstance(inner, dict) or name in inner:
            raise InputError(
                f"--set: {key.strip()} is given twice, or by an option of its own; give it once"
            )
        try:
            (inner[name],) = tomllib.loads(f"value = {text.strip()}").values()
        except ValueError:
            inner[name] = text.strip()
    return values


class Group(TyperGroup):
    """A group that lists its commands under their headings."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the complete first sentence of each command."""
        width = max(map(len, self.commands))
        formatter.write_paragraph()
        rows: dict[str, list[tuple[str, str]]] = {}
        all_commands: Any = self.commands.values()  # only Typer's commands have a heading
        for command in all_commands:
            row = command.name.ljust(width), command.get_short_help_str(1000)
            rows.setdefault(command.rich_help_panel or "Commands", []).append(row)
        for heading, lines in rows.items():
            formatter.write_heading(heading)
            with formatter.indentation():
                formatter.write_dl(lines)
