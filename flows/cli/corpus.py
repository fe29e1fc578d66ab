"""The commands `slgaussian ingest | supervise | dataset`, with lazy imports."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.run import report_left_out, run_flow
from flows.config import CorpusSettings, DatasetSettings
from flows.read_config import make_settings

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="SOURCE",
        help="Folder of any scene, or folder or URL of chunks; or procedural:FIRST-LAST.",
    ),
]


@options.add_options("most", *options.ENGINE, model=CorpusSettings)
def ingest(
    ctx: typer.Context, sources: Sources, out: options.Out, verbose: options.Verbose = False
) -> None:
    """Choose training samples in a corpus of clips.

    Writes views.parquet (camera, blur, exposure and distance of each view), pairs.parquet (two
    context and three target views each) and failures.parquet (what was left out, and why). Reads
    only new sources. Sources that are not chunks are also written to OUT/chunks in the format of
    RealEstate10K, each scene as a clip with the name of its folder. The exit status is 1 if
    something was left out.

    \b
    slgaussian ingest chunks/train -o corpus
    slgaussian ingest s3://bucket/re10k/train -o corpus --most 2
    slgaussian ingest procedural:0-39 office_walk -o corpus
    """
    _prepare("ingest", ctx, verbose)


@options.add_options("size", *options.COMPONENTS, "most", *options.ENGINE, model=CorpusSettings)
def supervise(
    ctx: typer.Context, sources: Sources, out: options.Out, verbose: options.Verbose = False
) -> None:
    """Label the samples of a corpus: lessons for `train`.

    Predicts Gaussians and object masks for all views. Writes the tables of `ingest` and
    lessons.parquet. Changing the masks reuses cached Gaussians.

    \b
    slgaussian supervise chunks/train -o corpus
    slgaussian supervise procedural:0-39 -o corpus --proposer sam --set sam.model=models/sam
    """
    _prepare("supervise", ctx, verbose)


def _prepare(command: str, ctx: typer.Context, verbose: bool) -> None:
    """Prepare a corpus, and print its tables and what was left out; exit with 1 if anything was."""
    settings = make_settings(options.settings_from(ctx, CorpusSettings), command, CorpusSettings)
    prepared = run_flow(command, settings, verbose)
    from flows.corpus import FILES

    for stage, count in prepared.rows.items():
        file = settings.out / FILES[stage]
        typer.echo(f"{count} {file.stem}  {file}")
    report_left_out(settings.out, prepared.failures)


@options.add_options("size", "targets", "held_out", *options.ENGINE, model=DatasetSettings)
def dataset(
    ctx: typer.Context,
    out: Annotated[Path, typer.Argument(help="Folder of the training set.")],
    sources: Sources,
    verbose: options.Verbose = False,
) -> None:
    """Make a training set for any network, as tar shards.

    Writes images, cameras, depth, labels and language features for `torch.utils.data`, `webdataset`
    and `datasets`; an index with measures of quality; and a data card. Running it again, also with
    more sources, computes only new samples. All clips of a place are in one split.

    \b
    slgaussian dataset set chunks/train kitchen office=walk office=office_two
    slgaussian dataset set photos --targets 1
    """
    values = options.settings_from(ctx, DatasetSettings)
    settings = make_settings(values, "dataset", DatasetSettings)
    written = run_flow("dataset", settings, verbose)
    from slgaussian.datasets.data_card import CARD
    from slgaussian.datasets.splits import FILE

    typer.echo(
        f"version {written.version}: {written.samples} samples of {written.places} places in "
        f"{written.shards} shards, {written.new_shards} of them new, "
        f"{written.bytes / 1e6:.1f} MB  {out}"
    )
    typer.echo(f"{written.split}  {out / FILE}")
    typer.echo(f"card  {out / CARD}")
    report_left_out(out, written.failures)
