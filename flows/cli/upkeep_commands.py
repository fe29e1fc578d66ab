"""The commands that look after an installation. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.command_settings import COMMON, FILES, UPKEEP
from flows.cli.help import App
from flows.cli.options import with_options
from slgaussian.errors import InputError

commands = App()


@commands.command(rich_help_panel=UPKEEP)
@with_options("store", "runner", *FILES, common=COMMON["doctor"])
def doctor(settings: dict) -> None:
    """Check what a run needs, and say what to do about it.

    Looks at packages, threads, the store, the Prefect server and the files and models that options
    name, and says of each: ok, BAD with what to do, or -- for what is missing and need not be
    there. A model is known by its digest where the hub has one, and otherwise loaded and tried.
    Nothing is downloaded. The exit status is 1 if anything is BAD.

    \b
    slgaussian doctor
    slgaussian doctor --store s3://bucket/slg --runner dask://10.0.0.5:8786
    slgaussian doctor --encoder clip --clip-model models/clip-vit-b-16
    """
    from flows.cli.doctor import examine
    from flows.settings import make_settings

    healthy = True
    for finding in examine(make_settings(settings, "doctor"), "runner" in settings):
        healthy &= finding.good is not False
        mark = {True: "ok ", False: "BAD", None: "-- "}[finding.good]
        typer.echo(f"{mark}  {finding.name:<12} {finding.said}")
    raise typer.Exit(0 if healthy else 1)


@commands.command(rich_help_panel=UPKEEP)
def parts(
    as_json: Annotated[bool, typer.Option("--json", help="Print them as JSON.")] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of a configuration file.")
    ] = False,
) -> None:
    """List the parts of the method, with their settings.

    Also those that other packages bring. What a file, folder or model holds decides what is
    computed anew, not where it is.

    \b
    slgaussian parts
    slgaussian parts --json
    slgaussian parts --schema
    """
    from flows.cli import parts as known
    from slgaussian.components import catalogue

    if as_json and schema:
        raise InputError("parts: --json and --schema are two outputs; choose one")
    shown = known.schema if schema else catalogue.as_json if as_json else catalogue.as_text
    typer.echo(shown())


@commands.command(rich_help_panel=UPKEEP)
def inspect(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="File or folder to inspect.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print all as JSON.")] = False,
) -> None:
    """Show the data spec, fields, units and origin of a file.

    Takes a table (Parquet), arrays (NPZ), weights (safetensors), JSON or Gaussians (.ply, .spz), or
    a folder, such as a field or the results of a run, file by file. The exit status is 1 if a file
    is damaged or not what its spec says.

    \b
    slgaussian inspect results/samples.parquet
    slgaussian inspect results/fields/kitchen --json
    slgaussian inspect scene.spz
    """
    import json
    from dataclasses import asdict

    from slgaussian.storage.inspection import inspect as look

    files = look(path)
    if as_json:
        typer.echo(json.dumps([asdict(file) for file in files], indent=1, ensure_ascii=False))
    for file in [] if as_json else files:
        typer.echo(f"{file.path}: {file.problem and 'BAD'}{file.spec} {file.digest[:12]}")
        typer.echo(f"  {file.problem or file.meaning}")
        for name, value in file.made.items():
            typer.echo(f"  {name}: {value if isinstance(value, str) else json.dumps(value)}")
        for row in file.fields:
            unit = f" ({row['unit']})" if row["unit"] else ""
            typer.echo(f"    {row['name']} {row['type']}{unit}: {row['meaning']}".rstrip(": "))
    raise typer.Exit(any(file.problem for file in files))
