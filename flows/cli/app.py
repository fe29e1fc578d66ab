"""The command line. Commands import large packages only when they run, so `--help` is fast."""

import warnings
from typing import Annotated, Any

import typer

from flows.cli import (
    ask,
    build,
    corpus,
    doctor,
    objects,
    options,
    run,
    score,
    show,
    store,
    train,
)  # fmt: skip
from slgaussian import __version__
from slgaussian.errors import SLGaussianError

COMMANDS = {
    "Build a field and query it": (
        build.demo, build.field, build.cameras, build.masks, ask.query, ask.segment, ask.words,
        objects.objects, show.render, show.view, show.export,
    ),
    "Score it": (run.run, run.benchmark, score.score, score.compare),
    "Train on many scenes": (
        corpus.ingest, corpus.supervise, corpus.dataset, train.train, train.retrain, train.versions,
    ),
    "Check files and installation": (doctor.doctor, store.inspect, store.store_app),
}  # fmt: skip
"""Commands and groups of commands, by the heading in the help."""

app = typer.Typer(
    cls=options.Group,
    no_args_is_help=True,
    help="From photographs to a 3D scene that answers words. Try `slgaussian demo`.",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for heading, commands in COMMANDS.items():
    for command in commands:
        if isinstance(command, typer.Typer):
            app.add_typer(command, rich_help_panel=heading)
        else:
            app.command(rich_help_panel=heading)(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"slgaussian {__version__}")
        raise typer.Exit


@app.callback()
def slgaussian(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show it.")
    ] = False,
) -> None:
    """Parse the options of the program itself."""


def _show_warning(message: Warning | str, *where: Any, **more: Any) -> None:
    typer.echo(f"warning: {message}", err=True)


def main() -> None:
    """Run the command line; errors for users are printed in one sentence, with exit status 2."""
    warnings.showwarning = _show_warning
    try:
        app(prog_name="slgaussian")
    except SLGaussianError as error:
        typer.echo(f"error: {error}", err=True)
        raise SystemExit(2) from None
