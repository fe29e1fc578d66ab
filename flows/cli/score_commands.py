"""The commands that score and compare. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.arguments import Out, Verbose
from flows.cli.command_settings import COMMON, RUN, SCORES
from flows.cli.help import App
from flows.cli.options import with_options
from flows.cli.running import run_and_say

commands = App()


def _baselines() -> list[str]:
    """The baselines whose names a shell takes as one word."""
    from slgaussian.benchmark.baselines import ROWS

    return [name for name in ("all", *ROWS) if " " not in name]


@commands.command(rich_help_panel=SCORES)
@with_options("data", "pairs", "labels", "format", "rooms", *RUN, common=COMMON["benchmark"])
def benchmark(
    settings: dict,
    photos: Annotated[
        list[str] | None,
        typer.Argument(metavar="PHOTO", help="Photographs without labels, or a folder."),
    ] = None,
    cameras: Annotated[
        Path | None,
        typer.Option(help="Their cameras; found if left out."),
    ] = None,
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
    out: Out = Path("slg-benchmark"),
    verbose: Verbose = False,
) -> None:
    """Score the method, and others, on a labelled set.

    Builds a field from each scene's context views and asks it in its target views. Leaves a report,
    tables, masks, fields, and failures.parquet. One of three photographs of your own is held out.

    \b
    slgaussian benchmark --rooms 0-19 --against query-2d --against lerf-like
    slgaussian benchmark --rooms 0-19 --sweep views=2,3 --sweep replicas=1,5
    slgaussian benchmark a.jpg b.jpg c.jpg --sweep preset=fast,paper
    slgaussian benchmark --data office --pairs office/pairs.json \\
        --labels office/labels -o scores
    """
    from flows.settings import make_settings

    given = {**settings, "against": against or [], "sweep": sweep or [], "out": out}
    made = make_settings(given, "benchmark")
    if photos or cameras is not None:
        from flows.cli.own_scene import with_photographs

        made = with_photographs(made, photos or [], cameras)
    run_and_say("benchmark", made, verbose)


def _protocols() -> list[str]:
    """The protocols by which masks are scored."""
    from slgaussian.benchmark.given import GIVEN

    return list(GIVEN)


@commands.command(rich_help_panel=SCORES)
@with_options("data", "pairs", "labels", "format", "rooms", "size")
def score(
    settings: dict,
    predictions: Annotated[
        Path,
        typer.Argument(
            metavar="PREDICTIONS", help="Folder of masks as `benchmark` writes it, or a JSON file."
        ),
    ],
    protocol: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<name>",
            autocompletion=_protocols,
            help="What scores mean: slgaussian, langsplat, langsplat-rescaled or 3d-ovs; may be "
            "repeated. [default: all that the folder has]",
        ),
    ] = None,
    out: Out = Path("slg-score"),
) -> None:
    """Score masks that you made, as `benchmark` scores its own.

    Masks are PNG files, METHOD/PROTOCOL/SCENE/FRAME/QUERY.png, or a JSON file of COCO's run
    lengths. One that is missing counts as empty. Without --pairs every labelled frame is asked what
    is labelled in it. Leaves tables and masks as `benchmark` does, which `compare` reads.

    \b
    slgaussian score masks --data office --pairs office/pairs.json \\
        --labels office/labels -o mine
    slgaussian score masks.json --rooms 0-19 --size 416x576 --protocol 3d-ovs
    slgaussian compare scores mine
    """
    from flows.settings import make_settings

    chosen = make_settings({**settings, "out": out}, "score")
    from flows.cli.scoring import score as scored

    table, said = scored(chosen, predictions, protocol or [], out)
    for text in said:
        typer.echo(text, err=True)
    typer.echo(table)
    typer.echo(out)


@commands.command(rich_help_panel=SCORES)
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
    slgaussian benchmark --rooms 0-9 --replicas 1 -o after
    slgaussian compare before after -o changes
    slgaussian compare ours theirs another -o board
    """
    from flows.cli.comparing import compare as compared

    typer.echo(compared(runs, out))


@commands.command(rich_help_panel=SCORES)
@with_options(of="flows.corpus_settings:IndexSettings", common=COMMON["pairs"])
def pairs(
    settings: dict,
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder of the data, as its format has it.")
    ],
    labels: Annotated[
        Path | None,
        typer.Option(help="Folder of labels, if the format has none of its own, or other ones."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="JSON file.")] = Path("pairs.json"),
) -> None:
    """Choose context views for the labelled frames of a set.

    Writes an index that `benchmark` reads: two context views for each labelled frame. They are
    never labelled themselves; they are sharp, overlap, and see nearly all of the labelled frame,
    which lies between them. The best such pair is taken. The file also holds the rule, what was
    measured, and the frames without a pair, so that anybody can score the same pairs.

    \b
    slgaussian pairs lerf_ovs --format lerf_ovs -o pairs.json
    slgaussian pairs 3dovs --format ovs3d -o pairs.json --max-baseline 0.6
    slgaussian pairs walk --labels walk/labels -o walk/pairs.json
    """
    from flows.corpus_settings import IndexSettings, check_bounds
    from flows.settings import checked

    chosen = checked(IndexSettings, settings, "pairs")
    check_bounds(chosen, "pairs")
    from flows.indexing import build_index

    index = build_index(data, labels, chosen, out)
    for name, reason in index.left_out.items():
        typer.echo(f"left out: {name}: {reason}", err=True)
    typer.echo(f"{len(index.pairs)} pairs  {out}")


@commands.command(rich_help_panel=SCORES)
@with_options(*RUN, common=COMMON["run"])
def run(
    settings: dict,
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results.")] = None,
    verbose: Verbose = False,
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
    slgaussian run kitchen.toml --preset fast -o fast
    """
    from flows.settings import read_toml

    given = settings if out is None else {**settings, "out": out}
    run_and_say("run", read_toml(config, given), verbose)
