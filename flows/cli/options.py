"""Options that several commands share, and the settings that they and ``--set`` give."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import BaseModel

from flows.corpus_settings import CorpusSettings
from flows.encoder_choice import AUTO
from flows.settings import Settings
from flows.training_settings import TrainSettings
from slgaussian.components.registry import KINDS, names_of
from slgaussian.errors import InputError


def field_option(
    name: str, model: type[BaseModel] = Settings, flag: str | None = None, help: str = ""
) -> Any:
    """Return the option of a field of a configuration: its description, default and values."""
    field = model.model_fields[name]
    text, values = help or field.description or "", tuple(field.examples or ())
    if name in KINDS:
        values = names_of(name) + ((AUTO,) if name == "encoder" else ())
        text = f"{', '.join(values[:-1])} or {values[-1]}."
    if field.default not in (None, []) and not field.is_required():
        shown = field.default
        shown = "x".join(map(str, shown)) if isinstance(shown, tuple) else shown
        text += f" [default: {shown}]"
    return typer.Option(
        flag or f"--{name.replace('_', '-')}",
        metavar=f"<{name}>",
        help=text,
        autocompletion=(lambda: list(values)) if values else None,
    )


Preset = Annotated[str | None, field_option("preset")]
Size = Annotated[str | None, field_option("size")]
SampleSize = Annotated[str | None, field_option("size", CorpusSettings)]
Predictor = Annotated[str | None, field_option("predictor")]
Proposer = Annotated[str | None, field_option("proposer")]
Tracker = Annotated[str | None, field_option("tracker")]
Encoder = Annotated[str | None, field_option("encoder")]
Seed = Annotated[int | None, field_option("seed")]
Threshold = Annotated[float | None, field_option("threshold")]
Store = Annotated[str | None, field_option("store")]
Runner = Annotated[str | None, field_option("runner")]
Workers = Annotated[int | None, field_option("workers")]
Refresh = Annotated[list[str] | None, field_option("refresh")]
Data = Annotated[Path | None, field_option("data")]
Pairs = Annotated[Path | None, field_option("pairs")]
Labels = Annotated[Path | None, field_option("labels")]
Format = Annotated[str | None, field_option("format")]
Rooms = Annotated[str | None, field_option("rooms")]
Most = Annotated[int | None, field_option("most", CorpusSettings)]
Steps = Annotated[int | None, field_option("steps", TrainSettings)]

Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="<key=value>",
        help="Any other field of the configuration, as clip.model=PATH; may be repeated.",
    ),
]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for every stage.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print it as JSON.")]

Photos = Annotated[
    list[str], typer.Argument(metavar="PHOTO", help="Two or more photographs, or a folder of them.")
]
Cameras = Annotated[
    Path | None,
    typer.Option(
        help="Their cameras: transforms.json, poses_bounds.npy, or a COLMAP folder; found if left "
        "out."
    ),
]
Refine = Annotated[
    bool, typer.Option("--refine", help="Find given cameras anew, in their own world.")
]
Folder = Annotated[
    Path, typer.Argument(metavar="FIELD", help="Folder that `field` wrote, or OUT/fields/SCENE.")
]
FieldOrPly = Annotated[
    Path, typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply.")
]
Words = Annotated[
    Path | None, typer.Option(help="Words taught elsewhere: words.npz of another field.")
]
Views = Annotated[
    list[str] | None,
    typer.Option(
        "--view",
        metavar="<name>",
        help="Look from this view, by name or number from 0; may be repeated. [default: 0]",
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        "--cameras",
        help="Look from other cameras: one as JSON, or a transforms.json.",
    ),
]
Between = Annotated[
    tuple[str, str, float] | None,
    typer.Option(
        metavar="A B T", help="Look from share T, 0 to 1, of the way from view A to view B."
    ),
]
Picture = Annotated[
    Path | None, typer.Option("--out", "-o", help="Picture of the answer: .png or .jpg.")
]


def settings_from(
    ctx: typer.Context, model: type[BaseModel] = Settings, **values: Any
) -> dict[str, Any]:
    """Return settings as a configuration file would have them, tables as nested dicts.

    They are the arguments of the command that are fields of ``model``, and texts ``KEY=VALUE`` or
    ``TABLE.KEY=VALUE`` of ``--set``. A value is read as TOML where it is valid TOML, else it is
    text. Relative paths are relative to the working folder.

    Parameters
    ----------
    ctx : Context
        Of the command.
    model : pydantic model
    **values
        Other fields.

    Raises
    ------
    InputError
        If a text has no such form, or a key is given twice.
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
