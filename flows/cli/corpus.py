"""The commands `slgaussian ingest | supervise | dataset`, with lazy imports."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pydantic import Field

from flows.cli import options
from flows.cli.run import prepare_prefect, report_left_out, run_flow
from flows.config import (
    CorpusSettings,
    DatasetSettings,
    Engine,
    PackSettings,
    Withdrawal,
)
from flows.read_config import checked, make_settings
from slgaussian.datasets.configs import Bounds
from slgaussian.errors import InputError

SET_FIELDS = ("size", "targets", "min_confirmed", "held_out")
"""Fields of a training set that are options of `slgaussian dataset`."""


class IngestSettings(PackSettings, Withdrawal, Bounds, Engine):
    """Sources, choice of samples, and output folder."""

    sources: list[str] = Field(min_length=1)
    out: Path


@options.configured("most", *options.ENGINE, model=IngestSettings)
def ingest(
    ctx: typer.Context,
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Chunks (a folder or URL); or folders of photographs, procedural:FIRST-LAST.",
        ),
    ],
    out: options.Out,
    verbose: options.Verbose = False,
) -> None:
    """Choose training samples in a corpus of chunks.

    Writes views.parquet (camera, blur, exposure and distance of each view), pairs.parquet (two
    context and three target views each) and failures.parquet (what was left out, and why). Reads
    only new chunks. Other sources are first added to OUT/chunks in the format of RealEstate10K,
    each scene as a clip with the name of its folder. The exit status is 1 if something was left
    out.

    \b
    slgaussian ingest chunks/train -o corpus
    slgaussian ingest s3://bucket/re10k/train -o corpus --most 2
    slgaussian ingest procedural:0-39 office_walk -o corpus --set views=24 --set baseline=1.6
    """
    settings = checked(IngestSettings, options.settings_from(ctx, IngestSettings), "ingest")
    prepare_prefect(settings.store)
    from flows.clip_sources import check_sources_exist, is_chunks
    from slgaussian.datasets.re10k import INDEX

    check_sources_exist(sources)
    chunks, left_out = sources[0], 0
    if not any(map(is_chunks, sources)):
        from flows.clip_sources import pack

        chunks = str(out / "chunks")
        packed = pack(sources, Path(chunks), settings)
        left_out = len(packed.left_out)
        typer.echo(f"{packed.clips} clips in {len(packed.chunks)} new chunks  {chunks}")
        if left_out:
            typer.echo(f"left out: {left_out}, for the reasons above", err=True)
        if not (Path(chunks) / INDEX).exists():
            raise typer.Exit(1)
    elif sources[1:]:
        raise InputError(
            f"ingest: found {len(sources)} sources with chunks among them; give one folder or URL "
            "of chunks, or only sources that are not chunks"
        )
    # ``--size`` of ingest applies to procedural rooms only.
    fields = CorpusSettings.model_fields.keys() & settings.model_fields_set - {"size"}
    values = {name: getattr(settings, name) for name in fields} | {"chunks": chunks}
    _prepare("ingest", make_settings(values, "ingest", CorpusSettings), verbose)
    if left_out:
        raise typer.Exit(1)


@options.configured("size", *options.COMPONENTS, "most", *options.ENGINE, model=CorpusSettings)
def supervise(
    ctx: typer.Context,
    chunks: Annotated[str, typer.Argument(help="Folder or fsspec URL of .torch chunks.")],
    out: options.Out,
    verbose: options.Verbose = False,
) -> None:
    """Label the samples of a corpus: lessons for `train`.

    Predicts Gaussians and object masks for all views. Writes the tables of `ingest` and
    lessons.parquet. Changing the masks reuses cached Gaussians.

    \b
    slgaussian supervise chunks/train -o corpus
    slgaussian supervise corpus/chunks -o corpus --proposer sam --set sam.model=models/sam
    """
    values = options.settings_from(ctx, CorpusSettings)
    _prepare("supervise", make_settings(values, "supervise", CorpusSettings), verbose)


def _prepare(command: str, settings: CorpusSettings, verbose: bool) -> None:
    """Prepare a corpus, and print its tables and what was left out; exit with 1 if anything was."""
    if "://" not in settings.chunks and not Path(settings.chunks).is_dir():
        raise InputError(
            f"{command}: {settings.chunks}: is no folder; expected a folder or fsspec URL of chunks"
        )
    prepared = run_flow(command, settings, verbose)
    from flows.corpus import FILES

    for stage, count in prepared.rows.items():
        file = settings.out / FILES[stage]
        typer.echo(f"{count} {file.stem}  {file}")
    report_left_out(settings.out, prepared.failures)


@options.configured(*SET_FIELDS, *options.ENGINE, model=DatasetSettings)
def dataset(
    ctx: typer.Context,
    out: Annotated[Path, typer.Argument(help="Folder of the training set.")],
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Folder of any scene, or of chunks; procedural:FIRST-LAST; or PLACE=SOURCE.",
        ),
    ],
    verbose: options.Verbose = False,
) -> None:
    """Make a training set for any network, as tar shards.

    Writes images, cameras, depth, labels and language features for `torch.utils.data`, `webdataset`
    and `datasets`; an index with measures of quality; and a data card. Running it again, also with
    more sources, computes only new samples. All clips of a place are in one split.

    \b
    slgaussian dataset set chunks/train kitchen office=walk office=office_two
    slgaussian dataset set photos --targets 1 --min-confirmed 0.5
    """
    values = options.settings_from(ctx, DatasetSettings)
    settings = make_settings(values, "dataset", DatasetSettings)
    prepare_prefect(settings.store)
    from flows.clip_sources import check_sources_exist

    check_sources_exist(sources)
    written = run_flow("dataset", settings, verbose)
    from flows.data_card import CARD

    typer.echo(
        f"{written.samples} samples of {written.places} places in {written.shards} shards, "
        f"{written.new_shards} of them new, {written.bytes / 1e6:.1f} MB  {out}"
    )
    typer.echo(f"card  {out / CARD}")
    report_left_out(out, written.failures)
