"""Options that several commands share, and the settings that they and ``--set`` give."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from slgaussian.errors import InputError

FIELDS, SCORES = "Build a field and ask it", "Score it"
CORPORA, UPKEEP = "Learn from many scenes", "Look after an installation"
"""The headings under which commands are listed."""


def _component(kind: str, text: str) -> Any:
    """Return the option of a kind of component; completion asks for the names that there are."""

    def names() -> list[str]:
        from slgaussian.components.registry import names_of

        return [*names_of(kind), *(["auto"] if kind == "encoder" else [])]

    return typer.Option(metavar="<name>", help=text, autocompletion=names)


def _data_formats() -> list[str]:
    from slgaussian.datasets import FROM_FILES

    return list(FROM_FILES)


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

Preset = Annotated[
    str | None,
    typer.Option(
        metavar="<name>",
        help="Begin from named settings: fast, balanced or paper; others win.",
        autocompletion=lambda: ["fast", "balanced", "paper"],
    ),
]
Size = Annotated[
    str | None,
    typer.Option(
        metavar="<size>",
        help="Height and width to work at: 416x576, 'at most 416x576', original or auto.",
    ),
]
SampleSize = Annotated[
    str | None,
    typer.Option(metavar="<size>", help="Height and width of the views. [default: 256x256]"),
]
Predictor = Annotated[
    str | None,
    _component("predictor", "planesweep or mvsplat. [default: planesweep]"),
]
Proposer = Annotated[str | None, _component("proposer", "regions, sam or sam2. [default: regions]")]
Tracker = Annotated[
    str | None,
    _component("tracker", "geometric, flow, sam2-video or precomputed. [default: geometric]"),
]
Encoder = Annotated[
    str | None, _component("encoder", "lexicon, clip, named or auto. [default: lexicon]")
]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of everything random. [default: 0]")]
Threshold = Annotated[
    float | None, typer.Option(help="Take what fits a text above this relevancy, 0 to 1.")
]
Store = Annotated[
    str | None,
    typer.Option(
        metavar="<path>",
        help="Folder or fsspec URL that keeps the results of every stage. [default: ./slg-data]",
    ),
]
Runner = Annotated[
    str | None,
    typer.Option(
        metavar="<name>",
        help="threads, processes, dask://host:port or ray://host:port. [default: threads]",
        autocompletion=lambda: ["threads", "processes"],
    ),
]
Workers = Annotated[
    int | None, typer.Option(help="Scenes (or chunks) done at a time. [default: 2]")
]
Refresh = Annotated[
    list[str] | None,
    typer.Option(
        metavar="<stage>", help="Compute a stage anew, and what follows from it; may be repeated."
    ),
]
Data = Annotated[Path | None, typer.Option(help="Folder of a labelled set, as its format has it.")]
Pairs = Annotated[
    Path | None, typer.Option(help="Its index: OUT/pairs.json of `benchmark`, or made by hand.")
]
Labels = Annotated[
    Path | None, typer.Option(help="Folder of its labels, if they are not in that of the data.")
]
Format = Annotated[
    str | None,
    typer.Option(
        metavar="<name>",
        help="Its format, if the index does not say, as lerf_ovs. [default: nerfstudio]",
        autocompletion=_data_formats,
    ),
]
Rooms = Annotated[
    str | None,
    typer.Option(metavar="<first-last>", help="Made-up rooms to score, by their seeds."),
]
Steps = Annotated[int | None, typer.Option(help="Steps of training. [default: 1500]")]
Most = Annotated[
    int | None, typer.Option(help="Most samples of a clip; 0 for as many as there are.")
]


FIELDS_OF_OPTIONS = (
    "preset", "size", "predictor", "proposer", "tracker", "encoder", "seed", "threshold", "store",
    "runner", "workers", "refresh", "data", "pairs", "labels", "format", "rooms", "steps", "most",
)  # fmt: skip
"""The options above that give fields of the configuration, as commands call their parameters."""


def settings_from(ctx: typer.Context, **values: Any) -> dict[str, Any]:
    """Return settings as a configuration file would have them, tables as nested dicts.

    They are those options of the command that give fields (:data:`FIELDS_OF_OPTIONS`), and texts
    ``KEY=VALUE`` or ``TABLE.KEY=VALUE`` of ``--set``. A value is read as TOML where it is valid
    TOML, else it is text. Relative paths are relative to the working folder.

    Parameters
    ----------
    ctx : Context
        Of the command.
    **values
        Other fields; None if not given.

    Raises
    ------
    InputError
        If a text has no such form, or a key is given twice.
    """
    values |= {name: ctx.params.get(name) for name in FIELDS_OF_OPTIONS}
    values = {name: value for name, value in values.items() if value not in (None, [], ())}
    assignments = ctx.params.get("set_")
    for assignment in assignments or ():
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
        inner[name] = _parsed(text.strip())
    return values


def _parsed(text: str) -> Any:
    try:
        (value,) = tomllib.loads(f"value = {text}").values()
    except (tomllib.TOMLDecodeError, ValueError):
        return text
    return value
