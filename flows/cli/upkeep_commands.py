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

    if as_json and schema:
        raise InputError("parts: --json and --schema are two outputs; choose one")
    typer.echo(known.schema() if schema else known.as_json() if as_json else known.listed())


@commands.command(rich_help_panel=UPKEEP)
def inspect(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="File or folder to look into.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print all as JSON.")] = False,
) -> None:
    """Say what a file holds, and what made it.

    Takes a table (Parquet), arrays (NPZ), weights (safetensors) or JSON that slgaussian wrote, an
    artifact of a store, the folder of a field, or the folder of a run's results. Says its data
    spec, each field with type, sizes, unit, range found and meaning, what made it with which
    settings, and its digest. The exit status is 1 if it is not what its spec says.

    \b
    slgaussian inspect results/samples.parquet
    slgaussian inspect results/fields/kitchen --json
    slgaussian inspect results
    """
    from flows.cli.inspecting import told
    from slgaussian.storage.inspection import inspect as look

    found = look(path)
    typer.echo(found.as_json() if as_json else told(found))
    raise typer.Exit(0 if found.sound else 1)
