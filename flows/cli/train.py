"""The commands `slgaussian train | retrain | versions`, with lazy imports."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.run import run_flow
from flows.config import RetrainSettings, TrainSettings
from flows.read_config import read_toml, validate_settings
from slgaussian.errors import InputError


@options.add_options("preset", "steps", "seed", "store", model=TrainSettings)
def train(
    ctx: typer.Context,
    lessons: Annotated[Path, options.field_option("lessons", TrainSettings)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for weights and report.")],
    start: Annotated[
        Path | None, typer.Option("--from", help="Initial weights, or a folder of versions.")
    ] = None,
    verbose: options.Verbose = False,
) -> None:
    """Train the semantic branch on lessons, and evaluate it.

    The evaluation uses held-out clips. Writes branch.safetensors, report.html, metrics.parquet (one
    row per step) and judgements.parquet (one row per held-out lesson and lifting). Resumes an
    interrupted training.

    \b
    slgaussian train --lessons corpus -o trained
    slgaussian train --lessons corpus --preset paper -o printed
    slgaussian train --lessons corpus --from trained/branch.safetensors --set batch=2 -o more
    slgaussian field a.png b.png --set lifting=branch \\
        --set branch.weights=trained/branch.safetensors -o field/
    """
    settings = validate_settings(TrainSettings, options.settings_from(ctx, TrainSettings), "train")
    trained = run_flow("train", settings, verbose)
    judgements = trained.judgements
    import numpy as np

    from flows.training import FILES
    from slgaussian.benchmark.reports.text_table import table_text
    from slgaussian.benchmark.significance import clip_scores, gate

    scores = clip_scores(judgements)
    rows = [[name, f"{np.mean(of_clips):.4f}"] for name, of_clips in scores.items()]
    typer.echo(table_text([["lifting", "IoU"], *rows]))
    for rival in scores:
        if rival in ("hard", "filled", "before"):
            typer.echo(gate(judgements, {rival: rival}).reason)
    typer.echo(f"{trained.split}  {lessons / 'places.parquet'}")
    typer.echo(f"weights  {out / FILES['weights']}")
    typer.echo(f"report   {out / FILES['report']}")


@options.add_options("sources", "models", "steps", "store", model=RetrainSettings)
def retrain(
    ctx: typer.Context,
    config: Annotated[Path | None, typer.Argument(help="TOML file with any settings.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for tables.")] = None,
    verbose: options.Verbose = False,
) -> None:
    """Train on new clips of a corpus; promote better weights.

    A candidate is trained from the weights in use, and promoted if it is significantly better on
    held-out clips than these and than no network. See `versions`. A file has sources, out, models
    and other settings; options override it. cron can run it, or Prefect by `prefect.yaml`. Writes
    MODELS/history.parquet, a row a retraining, and Prefect artifacts. The exit status is 0 if a
    version was promoted, 2 if it failed, 3 if the version was refused, 4 if the one in use is
    worse than none, 5 if another retraining is running, 6 if nothing is new.

    \b
    slgaussian retrain --sources chunks/train --out corpus --models models
    slgaussian retrain retrain.toml -o corpus
    """
    overrides = options.settings_from(ctx, RetrainSettings)
    settings = read_toml(config, overrides, RetrainSettings, "retrain")
    result = run_flow("retrain", settings, verbose)
    from flows.retraining import STATUS

    typer.echo("\n".join(result.messages))
    typer.echo(result.outcome)
    raise typer.Exit(STATUS[result.outcome])


def versions(
    models: Annotated[Path, typer.Argument(help="Folder of versions.")],
    use: Annotated[str | None, typer.Option(help="Use this version, or `none`.")] = None,
) -> None:
    """List the weights and last retrainings of `retrain`, or choose the version in use.

    You may use a version that the gate refused, or stop using one that it promoted.

    \b
    slgaussian versions models
    slgaussian versions models --use 3
    slgaussian versions models --use none
    """
    from slgaussian.benchmark.reports.text_table import table_text
    from slgaussian.benchmark.retrainings import read_history, summaries
    from slgaussian.semantic.versions import Versions

    folder = Versions(models)
    by_number = {version.number: version for version in folder.all()}
    if use is not None:
        if use != "none" and not (use.isdecimal() and int(use) in by_number):
            numbers = ", ".join(map(str, by_number)) or "no version"
            raise InputError(
                f"--use: found {use}, expected one of the versions there ({numbers}), or none"
            )
        folder.use(None if use == "none" else by_number[int(use)])
    if not by_number:
        typer.echo(f"{models}: no version")
        return
    current, latest = folder.current(), max(by_number.values(), key=lambda v: v.number)
    rows = [["version", "from", "made", "weights", "gate", "judged on", ""]]
    for version in by_number.values():
        mark, gate = " *" * (version == current), "passed" if version.promoted else "held"
        judged = version.split if version.split == latest.split else "another split"
        facts = [str(version.parent or "-"), version.made, version.digest[:12], gate, judged]
        rows.append([f"{version.number}{mark}", *facts, version.why])
    typer.echo(table_text(rows, "<>>>>><"))
    typer.echo("none is in use" if current is None else f"* in use: version {current.number}")
    if recent := summaries(read_history(models)):
        table = table_text([list(recent[0]), *(list(row.values()) for row in recent)], "<<")
        typer.echo(f"\nlast retrainings in {models / 'history.parquet'}\n{table}")
