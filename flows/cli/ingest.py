"""Make sources a corpus of chunks, and prepare its samples or lessons."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from pydantic import Field

from flows.cli.run import report_left_out, run_flow
from flows.corpus_settings import (
    CorpusSettings,
    PackSettings,
    PairSettings,
    Withdrawal,
    make_corpus_settings,
)
from flows.settings import Engine, checked
from slgaussian.datasets.re10k import INDEX
from slgaussian.errors import InputError


class IngestSettings(PackSettings, Withdrawal, PairSettings, Engine):
    """Sources, which samples are taken of them, and where they go."""

    sources: list[str] = Field(min_length=1)
    most: int = Field(0, ge=0)
    out: Path


def ingest_sources(values: dict[str, Any], verbose: bool) -> None:
    """Add sources that are no chunks to ``chunks`` of the output folder, and ingest the chunks.

    Scenes that are there already are left as they are. Exits with 1 if something was left out.

    Raises
    ------
    InputError
        If a value does not fit, a source is not there, or chunks are given beside other sources.
    """
    from flows.runners.environment import home_of, prepare
    from slgaussian.storage.store import ArtifactStore

    settings = checked(IngestSettings, values, "ingest")
    prepare(home_of(ArtifactStore(settings.store)))  # before Prefect is imported
    from flows.clip_sources import check_there, is_chunks

    check_there(settings.sources)
    chunks, left_out = settings.sources[0], 0
    if not any(map(is_chunks, settings.sources)):
        from flows.packing import pack

        chunks = str(settings.out / "chunks")
        packed = pack(settings.sources, Path(chunks), settings)
        left_out = len(packed.left_out)
        typer.echo(f"{packed.clips} clips in {len(packed.chunks)} new chunks  {chunks}")
        if left_out:
            typer.echo(f"left out: {left_out}, each said above", err=True)
        if not (Path(chunks) / INDEX).exists():
            raise typer.Exit(1)
    elif settings.sources[1:]:
        raise InputError(
            f"ingest: found {len(settings.sources)} sources, chunks among them; give one folder or "
            "URL of chunks alone, or sources that are no chunks"
        )
    fields = CorpusSettings.model_fields.keys() & settings.model_fields_set - {"size"}
    corpus = {name: getattr(settings, name) for name in fields}
    prepare_corpus("ingest", make_corpus_settings({**corpus, "chunks": chunks}, "ingest"), verbose)
    if left_out:
        raise typer.Exit(1)


def prepare_corpus(command: str, settings: CorpusSettings, verbose: bool) -> None:
    """Prepare a corpus, and print its tables and what was left out; exit with 1 if anything was."""
    prepared = run_flow(command, settings, verbose)
    from flows.corpus import FILES

    for stage, count in prepared.rows.items():
        file = settings.out / FILES[stage]
        typer.echo(f"{count} {file.stem}  {file}")
    report_left_out(settings.out, prepared.failures)
