"""The commands `slgaussian run | benchmark`, and functions of all commands that run flows."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from flows.cli import options
from flows.config import IndexSettings, Settings
from flows.read_config import make_settings, read_values, refuse_idle, validate_settings
from slgaussian.errors import InputError


@options.add_options("preset", "seed", *options.ENGINE, "only_missing")
def run(
    ctx: typer.Context,
    config: Annotated[Path, typer.Argument(help="TOML file with any of the settings.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results.")] = None,
    verbose: options.Verbose = False,
) -> None:
    """Run a configuration file, and write its report and fields.

    Options override the file. Paths in the file are relative to the file. A run leaves run.toml
    beside its report, which repeats it after a comparison of data, versions and processor.

    \b
    out = "results"
    replicas = 5
    [[scenes]]
    name = "kitchen"
    path = "kitchen/transforms.json"
    context = ["0001.png", "0009.png"]
    targets = ["0005.png"]
    queries = ["red kettle", "wooden table"]

    \b
    slgaussian run kitchen.toml
    slgaussian run kitchen.toml --preset fast --set replicas=1 -o fast
    slgaussian run results/run.toml -o again
    """
    from slgaussian.storage.run_file import Recorded

    overrides = options.settings_from(ctx)
    values = read_values(config, overrides)
    record = validate_settings(Recorded, {"inputs": values.pop("inputs", None)}, str(config))
    settings = validate_settings(Settings, values, str(config))
    refuse_idle(overrides, settings, "run")
    if record.inputs is not None:
        prepare_prefect(settings.store)
        from flows.benchmark import find_scenes
        from flows.results import check_inputs

        scenes, _ = find_scenes(settings)
        for line in check_inputs(settings, scenes, record.inputs, str(config)):
            typer.echo(line, err=True)
    run_scenes("run", settings, verbose)


@options.add_options(
    *options.LABELLED_SET, "preset", "size", "seed", *options.ENGINE, "sweep", "against"
)
def benchmark(
    ctx: typer.Context,
    photos: Annotated[
        list[str] | None,
        typer.Argument(metavar="PHOTO", help="Photographs without labels, or a folder."),
    ] = None,
    cameras: options.Cameras = None,
    out: options.Out = Path("slg-benchmark"),
    verbose: options.Verbose = False,
) -> None:
    """Score the method and baselines on a labelled set, procedural rooms or photographs.

    Builds a field from each scene's context views and scores queries in its target views. Without
    --pairs, two context views are chosen for each labelled frame (OUT/pairs.json). Of three or more
    photographs, the middle one is held out. Writes a report, tables, masks and fields.

    \b
    slgaussian benchmark --rooms 0-19 --against query-2d
    slgaussian benchmark a.jpg b.jpg c.jpg --sweep planesweep.depth_candidates=32,64
    slgaussian benchmark --data 3dovs --format ovs3d --set max_baseline=0.6
    slgaussian benchmark --data office --pairs office/pairs.json --labels office/labels
    """
    values = options.settings_from(ctx)
    rule = {key: values.pop(key) for key in IndexSettings.model_fields if key in values}
    if "format" in rule:
        values["format"] = rule["format"]
    settings = make_settings(values, "benchmark")
    if settings.data is not None and settings.pairs is None:
        chosen = validate_settings(IndexSettings, rule, "benchmark")
        prepare_prefect(settings.store)
        from flows.indexing import build_index
        from flows.runners.session import check_folder
        from slgaussian.datasets import check_format

        check_format(chosen.format)
        check_folder(settings.out)
        file = settings.out / "pairs.json"
        index = build_index(settings.data, settings.labels, chosen, file)
        for name, reason in index.left_out.items():
            typer.echo(f"left out: {name}: {reason}", err=True)
        typer.echo(f"{len(index.scenes)} pairs  {file}", err=True)
        settings = settings.model_copy(update={"pairs": file})
    elif fields := rule.keys() - {"format"}:
        raise InputError(
            f"benchmark: {min(fields)}: context views are chosen only for --data without --pairs; "
            "leave it out"
        )
    if photos:
        from flows.cli.photographs import held_out_scene

        scenes = [*settings.scenes, held_out_scene(photos, cameras)]
        settings = settings.model_copy(update={"scenes": scenes})
    elif cameras is not None:
        raise InputError("--cameras: given without photographs; add them, or leave it out")
    run_scenes("benchmark", settings, verbose)


def run_flow(command: str, config: Any, verbose: bool) -> Any:
    """Run the flow of a command, interruptible by Ctrl-C; return its result.

    SLGaussianError as the flow, and if the Prefect server fails.
    """
    from flows.runners.environment import FLOWS, call_flow, interruptible, orchestration
    from slgaussian.storage.store import ArtifactStore

    store = ArtifactStore(config.store)
    with interruptible(), orchestration(store) as wait_for_server:
        # The imports take as long as the start of the server.
        place, name = FLOWS[command].split(":")
        module = import_module(place)
        if hasattr(module, "check"):
            module.check(config, store)
        wait_for_server()
        return call_flow(getattr(module, name), config, verbose)


def run_scenes(command: str, settings: Any, verbose: bool) -> None:
    """Run scenes; print scores, report and failures; exit with status 1 if there are failures."""
    from slgaussian import precompile

    precompile.begin()
    results = run_flow(command, settings, verbose)
    from slgaussian.benchmark.reports.score_tables import scenes_text

    if results.results:
        typer.echo(scenes_text(results.results))
    if results.report is not None:
        typer.echo(f"report: {results.report}")
    if command == "demo":
        typer.echo(
            f"delete {settings.store} when you are done; it makes the next run fast\n"
            "your own photographs: slgaussian field a.jpg b.jpg -o field/\n"
            "and then: slgaussian view field/"
        )
    if results.ready:
        typer.echo(f"look at it: {results.look}\n{results.ready}")
    report_left_out(settings.out, results.failures)


def report_left_out(out: Path, failures: Sequence[Any]) -> None:
    """Print the number of failures and the first reason; exit with status 1 if there are any."""
    if failures:
        first = failures[0]
        typer.echo(
            f"left out: {len(failures)}, the first at {first.stage}: {first.reason}; all are in "
            f"{out / 'failures.parquet'}",
            err=True,
        )
        raise typer.Exit(1)


def prepare_prefect(store: str) -> None:
    """Set the environment of Prefect for a store, before anything imports Prefect."""
    from flows.runners.environment import find_prefect_home, prepare
    from slgaussian.storage.store import ArtifactStore

    opened = ArtifactStore(store)
    opened.check_writable()  # it has the home of Prefect
    prepare(find_prefect_home(opened))
