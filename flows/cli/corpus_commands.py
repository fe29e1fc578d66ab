"""The commands that learn from many scenes. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.arguments import Out, Verbose
from flows.cli.command_settings import COMMON, CORPORA, DATASET, INGEST, SUPERVISE, TRAIN
from flows.cli.help import App
from flows.cli.options import with_options
from flows.cli.running import performed, prepare_and_say, tell_left_out
from slgaussian.errors import InputError

commands = App()


Chunks = Annotated[
    str, typer.Argument(metavar="CHUNKS", help="Folder or fsspec URL of .torch chunks.")
]


@commands.command(rich_help_panel=CORPORA)
@with_options(of="flows.corpus_settings:PackSettings")
def pack(
    settings: dict,
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Folder of photographs, or procedural:FIRST-LAST (seeds of rooms).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the chunks.")],
) -> None:
    """Write scenes as chunks, the format of RealEstate10K.

    Each scene becomes one clip with the name of its folder. New clips are added to chunks that are
    there; a clip that is there already is refused.

    \b
    slgaussian pack procedural:0-39 office_walk -o chunks/train
    slgaussian pack procedural:40-59 -o chunks/train --views 24 --baseline 1.6
    """
    from flows.corpus_settings import PackSettings
    from flows.packing import pack as write
    from flows.settings import checked

    packed = write(sources, out, checked(PackSettings, settings, "pack"))
    typer.echo(f"{packed.clips} clips in {len(packed.chunks)} chunks  {out}")
    if packed.left_out:
        typer.echo(f"left out: {len(packed.left_out)}, each said above", err=True)
        raise typer.Exit(1)


@commands.command(rich_help_panel=CORPORA)
@with_options(*INGEST, of="flows.corpus_settings:CorpusSettings", common=COMMON["ingest"])
def ingest(settings: dict, chunks: Chunks, out: Out, verbose: Verbose = False) -> None:
    """Choose samples to learn from in a corpus of chunks.

    Looks at every view. Leaves views.parquet (camera, blur, exposure and distance of each view),
    pairs.parquet (two context and three target views each) and failures.parquet (what could not
    be used, and why). After new chunks were added, only those are read.

    \b
    slgaussian ingest chunks/train -o corpus
    slgaussian ingest s3://bucket/re10k/train -o corpus --most 2
    """
    prepare_and_say("ingest", {**settings, "chunks": chunks, "out": out}, verbose)


@commands.command(rich_help_panel=CORPORA)
@with_options(*SUPERVISE, of="flows.corpus_settings:CorpusSettings", common=COMMON["supervise"])
def supervise(settings: dict, chunks: Chunks, out: Out, verbose: Verbose = False) -> None:
    """Label the samples of a corpus: lessons for `train`.

    Predicts Gaussians and object masks for all views. Leaves what `ingest` leaves, lessons.parquet,
    and under sheets/ pictures of the labels: look at some. Other masks do not predict Gaussians
    again.

    \b
    slgaussian supervise chunks/train -o corpus
    slgaussian supervise chunks/train -o corpus \\
        --proposer sam --sam-model facebook/sam-vit-base
    """
    prepare_and_say("supervise", {**settings, "chunks": chunks, "out": out}, verbose)


@commands.command(rich_help_panel=CORPORA)
@with_options(*DATASET, of="flows.dataset_settings:DatasetSettings", common=COMMON["dataset"])
def dataset(
    settings: dict,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the training set.")],
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Folder of photographs, of a scene of any format, of chunks, or of camera files; "
            "procedural:FIRST-LAST; or PLACE=SOURCE.",
        ),
    ],
    verbose: Verbose = False,
) -> None:
    """Make a training set for any network, as tar shards.

    Images, cameras, depth, labels and language features for `torch.utils.data`, `webdataset` and
    `datasets`; an index of quality; and a data card. The same again, or with more sources, does
    only what is new. No place is in two splits.

    \b
    slgaussian dataset set chunks/train kitchen office=walk office=office_two
    slgaussian dataset set photos --targets 1 --min-confirmed 0.5
    """
    from flows.dataset_settings import make_dataset_settings

    chosen = make_dataset_settings({**settings, "out": out, "sources": sources})
    made = performed("dataset", chosen, verbose)
    from flows.data_card import CARD

    typer.echo(
        f"{made.samples} samples of {made.places} places in {made.shards} shards, "
        f"{made.new_shards} of them new, {made.bytes / 1e6:.1f} MB  {out}"
    )
    typer.echo(f"card  {out / CARD}")
    tell_left_out(out, made.failures)


@commands.command(rich_help_panel=CORPORA)
@with_options(
    *TRAIN, "architecture", "store",
    of="flows.training_settings:TrainSettings", common=COMMON["train"],
)  # fmt: skip
def train(
    settings: dict,
    lessons: Annotated[Path, typer.Option(help="Folder that `supervise` wrote, or `dataset`.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for weights and report.")],
    start: Annotated[
        Path | None,
        typer.Option("--from", help="Weights to begin from: a file, or a folder of versions."),
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Train the semantic branch on lessons, and judge it.

    It is judged on clips that it has not seen; of a training set made with --gaussians, on its
    split test. Leaves branch.safetensors, report.html,
    metrics.parquet (a row a step) and judgements.parquet (a row a held-out lesson and lifting).
    A training that was interrupted goes on where it was.

    \b
    slgaussian train --lessons corpus -o trained
    slgaussian train --lessons corpus --architecture paper -o paper
    slgaussian train --lessons corpus --from trained/branch.safetensors -o more
    slgaussian field a.png b.png --cameras transforms.json --lifting branch \\
        --branch-weights trained/branch.safetensors -o field/
    """
    from flows.settings import checked
    from flows.training_settings import TrainSettings

    given = {"lessons": lessons, "out": out} | ({} if start is None else {"start": start})
    chosen = checked(TrainSettings, {**settings, **given}, "train")
    made = performed("train", chosen, verbose)
    from flows.cli.tables import judgements_table
    from flows.training import FILES

    typer.echo(judgements_table(made.judgements))
    typer.echo(f"weights  {chosen.out / FILES['weights']}")
    typer.echo(f"report   {chosen.out / FILES['report']}")


@commands.command(rich_help_panel=CORPORA)
@with_options(
    "chunks",
    "out",
    "models",
    *TRAIN,
    *SUPERVISE,
    of="flows.training_settings:RetrainSettings",
    common=COMMON["retrain"],
)
def retrain(
    settings: dict,
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Learn what is new in a corpus; use it if it is better.

    New chunks are ingested and supervised, and a candidate is trained from the weights in use. It
    is put to use if it is better on held-out clips than those and than no network, beyond noise.
    Every version is kept; see `versions`. A file has chunks, out, models, store and other settings;
    options win over it. `nightly` does this by the clock.

    \b
    slgaussian retrain --chunks chunks/train --out corpus --models models
    slgaussian retrain retrain.toml --steps 300
    slgaussian field a.png b.png --cameras transforms.json --lifting branch \\
        --branch-weights models -o field/
    """
    from flows.training_settings import read_retraining

    chosen = read_retraining(config, settings)
    learnt, prepared = performed("retrain", chosen, verbose)
    if prepared.failures:
        file = chosen.out / "failures.parquet"
        typer.echo(f"left out: {len(prepared.failures)}; see {file}", err=True)
    typer.echo(learnt.said)


@commands.command(rich_help_panel=CORPORA)
@with_options(
    "chunks",
    "out",
    "models",
    *TRAIN,
    *SUPERVISE,
    of="flows.night_settings:NightSettings",
    common=COMMON["nightly"],
)
def nightly(
    settings: dict,
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")
    ],
    every: Annotated[
        float | None, typer.Option(help="Seconds: do it again and again, until stopped.")
    ] = None,
    cron: Annotated[
        str | None, typer.Option(help="Times to do it at, as cron writes them: '0 3 * * *'.")
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Do what `retrain` does, by the clock, and report it.

    A night leaves OUT/nights/NUMBER.json and an artifact of Prefect: what came, changed and was
    withdrawn, drift, scores, what was decided. Prefect's automations send notices. --every and
    --cron wait for their times, which needs `prefect server start` and PREFECT_API_URL. The exit
    status is 0 if a version was put to use, 1 if clips were left out first now and nothing else is
    new, 2 if the night failed, 3 if the version was refused, 4 if the one in use is worse than
    none, 5 if another night is on, 6 if nothing is new.

    \b
    slgaussian nightly night.toml
    slgaussian nightly night.toml --cron "0 3 * * *"
    """
    from flows.night_settings import read_night

    chosen = read_night(config, settings)
    if every is not None or cron is not None:
        from flows.runners.environment import home_of, prepare
        from slgaussian.storage.store import ArtifactStore

        prepare(home_of(ArtifactStore(chosen.store)))
        from flows.schedule import serve

        serve(config, settings, every, cron)
        return

    from flows.night_settings import STATUS
    from slgaussian.storage.locks import BusyError

    try:
        had = performed("nightly", chosen, verbose)
    except BusyError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(STATUS["busy"]) from None
    typer.echo("\n".join(had.said))
    typer.echo(f"{had.outcome}; record: {had.record}")
    raise typer.Exit(STATUS[had.outcome])


@commands.command(rich_help_panel=CORPORA)
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

    kept = Versions(models)
    known = {version.number: version for version in kept.all()}
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
        kept.use(None if use == "none" else known[int(use)], somebody(), why or "")
    if roll_back:
        kept.roll_back(somebody(), why or "")
    if history:
        typer.echo("\n".join(history_lines(kept.history())) or f"{models}: no history")
    elif known:
        typer.echo(versions_table(known.values(), kept.current(), kept.history()))
    else:
        typer.echo(f"{models}: no version")
