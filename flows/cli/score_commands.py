"""The commands that score and compare. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.options import settings_from

commands = typer.Typer()


@commands.command(rich_help_panel=options.SCORES)
def run(
    ctx: typer.Context,
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")
    ],
    preset: options.Preset = None,
    seed: options.Seed = None,
    store: options.Store = None,
    runner: options.Runner = None,
    workers: options.Workers = None,
    refresh: options.Refresh = None,
    set_: options.Set = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results.")] = None,
    verbose: options.Verbose = False,
) -> None:
    """Run a configuration file, and write its report and fields.

    Options given here win over the file. Paths in the file are relative to the file.

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
    """
    from flows.cli.run import run_scenes
    from flows.settings import read_toml

    values = settings_from(ctx, out=out)
    run_scenes("run", read_toml(config, values), verbose)


def _baselines() -> list[str]:
    """Return the baselines whose names a shell takes as one word."""
    from slgaussian.benchmark.baselines import ROWS

    return [name for name in ("all", *ROWS) if " " not in name]


@commands.command(rich_help_panel=options.SCORES)
def benchmark(
    ctx: typer.Context,
    photos: Annotated[
        list[str] | None,
        typer.Argument(metavar="PHOTO", help="Photographs without labels, or a folder."),
    ] = None,
    cameras: Annotated[Path | None, typer.Option(help="Their cameras; found if left out.")] = None,
    data: options.Data = None,
    pairs: options.Pairs = None,
    labels: options.Labels = None,
    format: options.Format = None,
    rooms: options.Rooms = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<field=a,b>",
            help="Compare settings, or numbers of views; may be repeated: all combinations.",
        ),
    ] = None,
    against: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<name>",
            autocompletion=_baselines,
            help="Another method to score as well, by name, or all but slow ones; may be repeated.",
        ),
    ] = None,
    preset: options.Preset = None,
    size: options.Size = None,
    seed: options.Seed = None,
    store: options.Store = None,
    runner: options.Runner = None,
    workers: options.Workers = None,
    refresh: options.Refresh = None,
    set_: options.Set = None,
    out: options.Out = Path("slg-benchmark"),
    verbose: options.Verbose = False,
) -> None:
    """Score the method, and others, on a labelled set.

    Builds a field from each scene's context views and asks it in its target views. Without --pairs,
    two context views are chosen for each labelled frame, and written to OUT/pairs.json. Leaves a
    report, tables, masks and fields. One of three photographs of your own is held out.

    \b
    slgaussian benchmark --rooms 0-19 --against query-2d --against lerf-like
    slgaussian benchmark a.jpg b.jpg c.jpg --sweep preset=fast,paper --sweep views=2,3
    slgaussian benchmark --data 3dovs --format ovs3d --set max_baseline=0.6
    slgaussian benchmark --data office --pairs office/pairs.json --labels office/labels
    """
    from flows.cli.benchmark import benchmark_settings
    from flows.cli.run import run_scenes

    values = settings_from(ctx, sweep=sweep, against=against, out=out)
    run_scenes("benchmark", benchmark_settings(values, photos or [], cameras), verbose)


def _protocols() -> list[str]:
    """Return the protocols by which masks are scored."""
    from slgaussian.benchmark.given import GIVEN

    return list(GIVEN)


@commands.command(rich_help_panel=options.SCORES)
def score(
    ctx: typer.Context,
    predictions: Annotated[
        Path,
        typer.Argument(
            metavar="PREDICTIONS", help="Folder of masks as `benchmark` writes it, or a JSON file."
        ),
    ],
    data: options.Data = None,
    pairs: options.Pairs = None,
    labels: options.Labels = None,
    format: options.Format = None,
    rooms: options.Rooms = None,
    size: options.Size = None,
    protocol: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<name>",
            autocompletion=_protocols,
            help="What scores mean: slgaussian, langsplat, langsplat-rescaled or 3d-ovs; may be "
            "repeated. [default: all that the folder has]",
        ),
    ] = None,
    out: options.Out = Path("slg-score"),
) -> None:
    """Score masks that you made, as `benchmark` scores its own.

    Masks are PNG files, METHOD/PROTOCOL/SCENE/FRAME/QUERY.png, or a JSON file of COCO's run
    lengths. One that is missing counts as empty. Without --pairs every labelled frame is asked what
    is labelled in it. Leaves tables and masks as `benchmark` does, which `compare` reads.

    \b
    slgaussian score masks --data office --pairs office/pairs.json --labels office/labels -o mine
    slgaussian score masks.json --rooms 0-19 --size 416x576 --protocol 3d-ovs
    slgaussian compare scores mine
    """
    from flows.settings import make_settings

    values = settings_from(ctx, out=out)
    settings = make_settings(values, "score")
    from flows.cli.score import score as score_masks

    table, notes = score_masks(settings, predictions, protocol or [], out)
    for note in notes:
        typer.echo(note, err=True)
    typer.echo(table)
    typer.echo(out)


@commands.command(rich_help_panel=options.SCORES)
def compare(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="Folders that benchmark, run or score wrote."),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for compare.html and compare.md.")
    ] = None,
) -> None:
    """Compare the settings and the scores of two runs, or rank those of more.

    Of two, differences are the second minus the first, for each method, on the queries that both
    were asked, with bootstrap intervals over scenes. Of more, methods are ranked in a table for
    each data set, protocol and size; only what was asked the same is in one table.

    \b
    slgaussian benchmark --rooms 0-9 -o before
    slgaussian benchmark --rooms 0-9 --set replicas=1 -o after
    slgaussian compare before after -o changes
    slgaussian compare ours theirs another -o board
    """
    from flows.cli.compare import compare as compared

    typer.echo(compared(runs, out))
