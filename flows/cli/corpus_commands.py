"""The commands that learn from many scenes. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.options import settings_from
from slgaussian.errors import InputError

commands = typer.Typer()

Config = typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")


@commands.command(rich_help_panel=options.CORPORA)
def ingest(
    ctx: typer.Context,
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Folder or fsspec URL of .torch chunks; or folders of photographs or camera "
            "files, and procedural:FIRST-LAST (seeds of rooms).",
        ),
    ],
    out: options.Out,
    most: options.Most = None,
    store: options.Store = None,
    runner: options.Runner = None,
    workers: options.Workers = None,
    set_: options.Set = None,
    verbose: options.Verbose = False,
) -> None:
    """Choose samples to learn from in a corpus of chunks.

    Looks at every view. Leaves views.parquet (camera, blur, exposure and distance of each view),
    pairs.parquet (two context and three target views each) and failures.parquet (what could not
    be used, and why). After new chunks were added, only those are read.

    Sources that are no chunks are first added to OUT/chunks, in the format of RealEstate10K, each
    scene as a clip with the name of its folder; those that are there are left as they are. The exit
    status is 1 if something was left out.

    \b
    slgaussian ingest chunks/train -o corpus
    slgaussian ingest s3://bucket/re10k/train -o corpus --most 2
    slgaussian ingest procedural:0-39 office_walk -o corpus --set views=24 --set baseline=1.6
    """
    from flows.cli.ingest import ingest_sources

    values = settings_from(ctx, sources=sources, out=out)
    ingest_sources(values, verbose)


@commands.command(rich_help_panel=options.CORPORA)
def supervise(
    ctx: typer.Context,
    chunks: Annotated[
        str, typer.Argument(metavar="CHUNKS", help="Folder or fsspec URL of .torch chunks.")
    ],
    out: options.Out,
    size: options.SampleSize = None,
    predictor: options.Predictor = None,
    proposer: options.Proposer = None,
    tracker: options.Tracker = None,
    most: options.Most = None,
    store: options.Store = None,
    runner: options.Runner = None,
    workers: options.Workers = None,
    set_: options.Set = None,
    verbose: options.Verbose = False,
) -> None:
    """Label the samples of a corpus: lessons for `train`.

    Predicts Gaussians and object masks for all views. Leaves what `ingest` leaves, lessons.parquet,
    and under sheets/ pictures of the labels: look at some. Other masks do not predict Gaussians
    again.

    \b
    slgaussian supervise chunks/train -o corpus
    slgaussian supervise corpus/chunks -o corpus --proposer sam --set sam.model=models/sam
    """
    from flows.cli.ingest import prepare_corpus
    from flows.corpus_settings import make_corpus_settings

    values = settings_from(ctx, chunks=chunks, out=out)
    prepare_corpus("supervise", make_corpus_settings(values, "supervise"), verbose)


@commands.command(rich_help_panel=options.CORPORA)
def dataset(
    ctx: typer.Context,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the training set.")],
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Folder of photographs, of a scene of any format, of chunks, or of camera files; "
            "procedural:FIRST-LAST; or PLACE=SOURCE.",
        ),
    ],
    size: options.SampleSize = None,
    targets: Annotated[
        int | None, typer.Option(help="Target views of a sample. [default: 3]")
    ] = None,
    min_confirmed: Annotated[
        float | None,
        typer.Option(help="Least share of the depth that a second view confirms. [default: 0.0]"),
    ] = None,
    held_out: Annotated[
        float | None,
        typer.Option(help="Share of the places that go to the split test. [default: 0.2]"),
    ] = None,
    gaussians: Annotated[
        bool, typer.Option("--gaussians", help="Store the Gaussians too, not depth alone.")
    ] = False,
    store: options.Store = None,
    runner: options.Runner = None,
    workers: options.Workers = None,
    set_: options.Set = None,
    verbose: options.Verbose = False,
) -> None:
    """Make a training set for any network, as tar shards.

    Images, cameras, depth, labels and language features for `torch.utils.data`, `webdataset` and
    `datasets`; an index of quality; and a data card. The same again, or with more sources, does
    only what is new. No place is in two splits.

    \b
    slgaussian dataset set chunks/train kitchen office=walk office=office_two
    slgaussian dataset set photos --targets 1 --min-confirmed 0.5
    """
    from flows.cli.run import report_left_out, run_flow
    from flows.data_card import CARD
    from flows.dataset_settings import make_dataset_settings

    values = settings_from(
        ctx,
        out=out,
        sources=sources,
        targets=targets,
        min_confirmed=min_confirmed,
        held_out=held_out,
        gaussians=gaussians or None,
    )
    written = run_flow("dataset", make_dataset_settings(values), verbose)
    typer.echo(
        f"{written.samples} samples of {written.places} places in {written.shards} shards, "
        f"{written.new_shards} of them new, {written.bytes / 1e6:.1f} MB  {out}"
    )
    typer.echo(f"card  {out / CARD}")
    report_left_out(out, written.failures)


@commands.command(rich_help_panel=options.CORPORA)
def train(
    ctx: typer.Context,
    lessons: Annotated[Path, typer.Option(help="Folder that `supervise` wrote, or `dataset`.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for weights and report.")],
    start: Annotated[
        Path | None,
        typer.Option("--from", help="Weights to begin from: a file, or a folder of versions."),
    ] = None,
    steps: options.Steps = None,
    architecture: Annotated[
        str | None,
        typer.Option(
            metavar="<name>",
            help="What the branch sees of a pixel: what several views say, or as the paper its own "
            "alone. [default: several]",
            autocompletion=lambda: ["several", "paper"],
        ),
    ] = None,
    seed: options.Seed = None,
    store: options.Store = None,
    set_: options.Set = None,
    verbose: options.Verbose = False,
) -> None:
    """Train the semantic branch on lessons, and judge it.

    It is judged on clips that it has not seen; of a training set made with --gaussians, on its
    split test. Leaves branch.safetensors, report.html, metrics.parquet (a row a step) and
    judgements.parquet (a row a held-out lesson and lifting). A training that was interrupted goes
    on where it was.

    \b
    slgaussian train --lessons corpus -o trained
    slgaussian train --lessons corpus --from trained/branch.safetensors --set batch=2 -o more
    slgaussian field a.png b.png --set lifting=branch \\
        --set branch.weights=trained/branch.safetensors -o field/
    """
    from flows.cli.run import run_flow
    from flows.settings import checked
    from flows.training_settings import TrainSettings

    values = settings_from(ctx, lessons=lessons, out=out, start=start, architecture=architecture)
    trained = run_flow("train", checked(TrainSettings, values, "train"), verbose)
    from flows.cli.tables import judgements_table
    from flows.training import FILES

    typer.echo(judgements_table(trained.judgements))
    typer.echo(f"weights  {out / FILES['weights']}")
    typer.echo(f"report   {out / FILES['report']}")


@commands.command(rich_help_panel=options.CORPORA)
def retrain(
    ctx: typer.Context,
    config: Annotated[Path | None, Config] = None,
    chunks: Annotated[str | None, typer.Option(help="Folder or fsspec URL of the chunks.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the tables and contact sheets.")
    ] = None,
    models: Annotated[
        Path | None, typer.Option(help="Folder of the versions of the weights.")
    ] = None,
    every: Annotated[
        float | None, typer.Option(help="Seconds: do it again and again, until stopped.")
    ] = None,
    cron: Annotated[
        str | None, typer.Option(help="Times to do it at, as cron writes them: '0 3 * * *'.")
    ] = None,
    steps: options.Steps = None,
    store: options.Store = None,
    set_: options.Set = None,
    verbose: options.Verbose = False,
) -> None:
    """Learn what is new in a corpus; use it if it is better.

    A candidate is trained from the weights in use, and put to use if it is better on held-out clips
    than those and than no network, beyond noise. See `versions`. A file has chunks, out, models and
    other settings; options win over it. --every and --cron need `prefect server start` and
    PREFECT_API_URL. Leaves OUT/history/NUMBER.json, and an artifact of Prefect. The exit status is
    0 if a version was put to use, 1 if clips were left out first now and nothing else is new, 2 if
    it failed, 3 if the version was refused, 4 if the one in use is worse than none, 5 if another
    retraining is on, 6 if nothing is new.

    \b
    slgaussian retrain --chunks chunks/train --out corpus --models models
    slgaussian retrain retrain.toml --cron "0 3 * * *"
    """
    from flows.training_settings import read_retraining

    settings = read_retraining(config, settings_from(ctx, chunks=chunks, out=out, models=models))
    if every is not None or cron is not None:
        from flows.runners.environment import home_of, prepare
        from slgaussian.storage.store import ArtifactStore

        prepare(home_of(ArtifactStore(settings.store)))
        from flows.schedule import serve

        serve(settings, every, cron)
        return
    from flows.cli.run import run_flow

    result = run_flow("retrain", settings, verbose)
    from flows.retraining import STATUS

    typer.echo("\n".join(result.messages))
    typer.echo(f"{result.outcome}; record: {result.record}" if result.record else result.outcome)
    raise typer.Exit(STATUS[result.outcome])


@commands.command(rich_help_panel=options.CORPORA)
def versions(
    models: Annotated[Path, typer.Argument(metavar="MODELS", help="Folder of versions.")],
    use: Annotated[
        str | None,
        typer.Option(
            metavar="<number>", help="Put the version of this number to use, or none with `none`."
        ),
    ] = None,
    roll_back: Annotated[
        bool,
        typer.Option(
            "--roll-back", help="Put to use what the one in use was trained from, be it none."
        ),
    ] = False,
    why: Annotated[str | None, typer.Option(help="Reason, for the history.")] = None,
    history: Annotated[
        bool, typer.Option("--history", help="Who or what put which version to use when, and why.")
    ] = False,
) -> None:
    """List the weights that `retrain` keeps, or switch to others.

    What the gate refused can be put to use by hand, and what it let pass can be taken out of use.

    \b
    slgaussian versions models
    slgaussian versions models --use 3 --why "sharper in the kitchen"
    slgaussian versions models --roll-back
    slgaussian versions models --use none
    slgaussian versions models --history
    """
    from flows.cli.tables import history_lines, versions_table
    from slgaussian.semantic.versions import Versions, somebody

    folder = Versions(models)
    known = {version.number: version for version in folder.all()}
    if use is not None and roll_back:
        raise InputError("versions: --use and --roll-back are two ways; choose one")
    if why is not None and use is None and not roll_back:
        raise InputError("versions: --why is for --use and --roll-back")
    if use is not None:
        if use != "none" and not (use.isdecimal() and int(use) in known):
            numbers = ", ".join(map(str, known)) or "no version"
            raise InputError(
                f"--use: found {use}, expected one of the versions there ({numbers}), or none"
            )
        folder.use(None if use == "none" else known[int(use)], somebody(), why or "")
    if roll_back:
        folder.roll_back(somebody(), why or "")
    if history:
        typer.echo("\n".join(history_lines(folder.history())) or f"{models}: no history")
    elif known:
        typer.echo(versions_table(known.values(), folder.current(), folder.history()))
    else:
        typer.echo(f"{models}: no version")
