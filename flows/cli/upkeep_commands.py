"""The commands that look after an installation. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.options import settings_from
from flows.cli.store_commands import store_app
from slgaussian.errors import InputError

commands = typer.Typer()
commands.add_typer(store_app, name="store", rich_help_panel=options.UPKEEP)


@commands.command(rich_help_panel=options.UPKEEP)
def doctor(
    ctx: typer.Context,
    store: options.Store = None,
    runner: options.Runner = None,
    predictor: options.Predictor = None,
    proposer: options.Proposer = None,
    tracker: options.Tracker = None,
    encoder: options.Encoder = None,
    set_: options.Set = None,
    components: Annotated[
        bool,
        typer.Option("--components", help="List the components and their fields, no checks."),
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of a configuration file.")
    ] = False,
) -> None:
    """Check what a run needs, and say what to do about it.

    Looks at packages, threads, the store, the Prefect server and the files and models that options
    name, and says of each: ok, BAD with what to do, or -- for what is missing and need not be
    there. A model is known by its digest where the hub has one, and otherwise loaded and tried.
    Nothing is downloaded. The exit status is 1 if anything is BAD.

    \b
    slgaussian doctor
    slgaussian doctor --store s3://bucket/slg --runner dask://10.0.0.5:8786
    slgaussian doctor --encoder clip --set clip.model=models/clip-vit-b-16
    slgaussian doctor --components
    """
    if components and schema:
        raise InputError("doctor: --components and --schema are two outputs; choose one")
    if components:
        from slgaussian.components.catalogue import as_text

        typer.echo(as_text())
        return
    import json

    from flows.cli.doctor import examine
    from flows.settings import Settings, make_settings

    if schema:
        typer.echo(json.dumps(Settings.model_json_schema(), indent=1))
        return
    values = settings_from(ctx)
    healthy = True
    for finding in examine(make_settings(values, "doctor"), "runner" in values):
        healthy &= finding.good is not False
        mark = {True: "ok ", False: "BAD", None: "-- "}[finding.good]
        typer.echo(f"{mark}  {finding.name:<12} {finding.said}")
    raise typer.Exit(0 if healthy else 1)


@commands.command(rich_help_panel=options.UPKEEP)
def inspect(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="File or folder to inspect.")],
    as_json: options.AsJson = False,
) -> None:
    """Show the data spec, origin and digest of a file, and check it.

    Takes a table (Parquet), arrays (NPZ), weights (safetensors) or JSON, or a folder, such as a
    field or the results of a run, file by file. The exit status is 1 if a file is damaged or not
    what its spec says.

    \b
    slgaussian inspect results/samples.parquet
    slgaussian inspect results/fields/kitchen --json
    """
    import json

    from slgaussian.storage.inspection import inspect as inspect_files

    files = inspect_files(path)
    if as_json:
        typer.echo(json.dumps(files, indent=1, ensure_ascii=False))
    for file in [] if as_json else files:
        state = "BAD" if file["problem"] else file["spec"]
        typer.echo(f"{file['path']}: {state} {file['digest'][:12]}")
        typer.echo(f"  {file['problem'] or file['meaning']}")
        for name, value in file["made"].items():
            typer.echo(f"  {name}: {value if isinstance(value, str) else json.dumps(value)}")
    raise typer.Exit(any(file["problem"] for file in files))
