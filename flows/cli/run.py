"""Run flows, and print what came of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from flows.runners.commands import perform
from flows.runners.environment import interruptible
from slgaussian import ahead


def run_flow(command: str, settings: Any, verbose: bool) -> Any:
    """Return what came of the flow of a command, which can be interrupted."""
    with interruptible():
        return perform(command, settings, verbose)


def run_scenes(command: str, settings: Any, verbose: bool) -> None:
    """Run scenes, and print scores, report and what was left out; exit with 1 if anything was."""
    ahead.begin()
    finished = run_flow(command, settings, verbose)
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


def report_left_out(out: Path, failures: Sequence[Any]) -> None:
    """Print how much was left out and where the reasons are; exit with 1 if anything was."""
    if failures:
        first = failures[0]
        typer.echo(
            f"left out: {len(failures)}, the first at {first.stage}: {first.reason}; all are in "
            f"{out / 'failures.parquet'}",
            err=True,
        )
        raise typer.Exit(1)
