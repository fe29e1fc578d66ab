"""The commands `slgaussian score` and `slgaussian compare`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.read_config import make_settings

MAX_NAMED = 3
"""Largest number of names of missing or unused masks in a message."""


@options.add_options(*options.LABELLED_SET, "size")
def score(
    ctx: typer.Context,
    predictions: Annotated[Path, typer.Argument(help="Masks: folder, Parquet or JSON file.")],
    protocols: Annotated[
        list[str] | None,
        typer.Option("--protocol", help="slgaussian, langsplat, langsplat-rescaled or 3d-ovs."),
    ] = None,
    out: options.Out = Path("slg-score"),
) -> None:
    """Score your masks as `benchmark` scores its own.

    Masks are PNG files, METHOD/PROTOCOL/SCENE/FRAME/QUERY.png, or COCO run-length encodings in a
    JSON file or in the masks.parquet of a run. A missing mask counts as empty. Without --pairs, the
    queries of each labelled frame are its labels; without --protocol, all protocols in the folder
    are scored. Writes tables and masks as `benchmark` does, which `compare` reads.

    \b
    slgaussian score masks --data office --pairs office/pairs.json --labels office/labels -o mine
    slgaussian score masks.json --rooms 0-19 --size 416x576 --protocol 3d-ovs
    slgaussian compare scores mine
    """
    settings = make_settings(options.settings_from(ctx), "score")
    from flows import scoring
    from slgaussian.benchmark.reports.score_tables import methods_text

    scores = scoring.score(settings, predictions, protocols or [], out)
    notes, masks = [*scores.messages], scores.predictions
    if masks.missing:
        notes.append(
            f"missing: {len(masks.missing)} of {masks.samples} samples have no mask and count as "
            f"an empty one: {_first_names(list(dict.fromkeys(masks.missing)))}"
        )
    if masks.extra:
        notes.append(f"not queried, left out: {_first_names(masks.extra)}")
    for note in notes:
        typer.echo(note, err=True)
    typer.echo(f"{methods_text(scores.samples)}\n{out}")


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", help="Folders of results.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the pages.")] = None,
    fail_below: Annotated[
        float | None, typer.Option(min=0, metavar="LOSS", help="Exit with 1 if a method lost more.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare the settings and scores of runs, and rank their methods.

    Prints each run minus the first, for each method, on the queries of both runs, with bootstrap
    intervals over scenes. Methods are ranked in a table for each data set, protocol and size; a
    table has only results for the same queries. With --fail-below, the exit status is 1 if the mean
    IoU of a method over the common scenes fell by more (on any data set; of the first score and
    protocol), and 2 if there is nothing to compare.

    \b
    slgaussian compare before after -o changes
    slgaussian compare main branch --fail-below 0.02 --json
    slgaussian compare ours theirs another -o board
    """
    from slgaussian.benchmark.outputs import write_file
    from slgaussian.benchmark.reports import comparison

    tables = [comparison.read_run(folder) for folder in runs]
    report, rows = comparison.compare_runs(tables)
    typer.echo(json.dumps(rows, indent=1, ensure_ascii=False) if as_json else report.as_text())
    if out is not None:
        write_file(out / "compare.html", report.as_html().encode())
        write_file(out / "compare.md", report.as_markdown().encode())
        typer.echo(f"\npage: {out / 'compare.html'}", err=as_json)
    if fail_below is not None:
        lost = comparison.list_losses(tables, rows, fail_below)
        typer.echo(
            "\n".join(lost) or f"no scene is absent, and no method lost more than {fail_below:g}",
            err=True,
        )
        raise typer.Exit(bool(lost))


def _first_names(names: Sequence[str]) -> str:
    rest = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return ", ".join(names[:MAX_NAMED]) + rest
