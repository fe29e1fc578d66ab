"""Perform a command and say what came of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from slgaussian import ahead


def run_and_say(command: str, settings: Any, verbose: bool) -> None:
    """Perform a run, and print its scores, its report and what was left out; 1 if anything was."""
    ahead.begin()
    finished = performed(command, settings, verbose)
    from flows.cli.tables import scores_tables

    if finished.results:
        typer.echo(scores_tables(finished.results))
    if finished.report is not None:
        typer.echo(f"report: {finished.report}")
    if finished.failures:
        left_out = ", ".join(failure.scene for failure in finished.failures)
        typer.echo(f"left out: {left_out}; see {settings.out / 'failures.parquet'}", err=True)
    if finished.ready:
        typer.echo(f"look at it: {finished.look}")
        typer.echo(finished.ready)
    if finished.failures:
        raise typer.Exit(1)


def prepare_and_say(command: str, values: dict[str, Any], verbose: bool) -> None:
    """Prepare a corpus, and print its tables and what was left out; 1 if anything was."""
    from flows.corpus_settings import make_corpus_settings

    settings = make_corpus_settings(values, command)
    made = performed(command, settings, verbose)
    from flows.corpus import FILES

    for stage, count in made.rows.items():
        file = settings.out / FILES[stage]
        typer.echo(f"{count} {file.stem}  {file}")
    tell_left_out(settings.out, made.failures)


def tell_left_out(out: Path, failures: Sequence[Any]) -> None:
    """Say how much was left out and where the reasons are, and exit with 1, if anything was."""
    if failures:
        first = failures[0]
        typer.echo(
            f"left out: {len(failures)}, the first at {first.stage}: {first.reason}; all are in "
            f"{out / 'failures.parquet'}",
            err=True,
        )
        raise typer.Exit(1)


def performed(command: str, settings: Any, verbose: bool) -> Any:
    """What came of a command that can be interrupted."""
    from flows.runners.commands import perform
    from flows.runners.environment import interruptible

    with interruptible():
        return perform(command, settings, verbose)
