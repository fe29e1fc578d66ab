"""The commands `slgaussian inspect` and `slgaussian store gc | purge | status`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli import options
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.storage.store import ArtifactStore

MAX_NAMED = 20
"""Largest number of damaged files that are named."""

store_app = typer.Typer(
    name="store", cls=options.Group, no_args_is_help=True, help="Clean a store."
)


def inspect(
    path: Annotated[str, typer.Argument(help="File, folder, or store by its URL.")],
    answer: Annotated[
        str | None,
        typer.Option("--of", metavar="SCENE/QUERY", help="Trace answers in the results of a run."),
    ] = None,
    openlineage: Annotated[
        str | None,
        typer.Option(metavar="FILE|URL", help="Write or send the lineage of a run, as events."),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Show the spec, fields and provenance of a file, and check it.

    Reads tables (Parquet), arrays (NPZ), weights (safetensors) and JSON, or all files of a folder,
    such as a field or the results of a run. Files of a store are counted by stage, and damaged ones
    named; with --json all are. The exit status is 1 if a file is damaged, or a table or arrays
    break their spec.

    --of follows the numbers of a report back to stages, settings, and the photographs, labels and
    weights; --openlineage does so for the whole run, or for --of, as OpenLineage events.

    \b
    slgaussian inspect results/samples.parquet
    slgaussian inspect results/fields/kitchen --json
    slgaussian inspect s3://bucket/slg
    slgaussian inspect results/report.html --of "kitchen/red kettle"
    slgaussian inspect results --openlineage events.ndjson
    """
    if answer is not None or openlineage is not None:
        from slgaussian.benchmark import lineage

        traced = lineage.trace(path, answer)
        if openlineage is not None:
            typer.echo(f"{lineage.send(traced, path, openlineage)} events  {openlineage}", err=True)
        elif as_json:
            typer.echo(json.dumps(traced, indent=1, ensure_ascii=False))
        else:
            typer.echo("\n".join(lineage.format_trace(traced)))
        return
    from slgaussian.storage import inspection

    walked, files = inspection.inspect(path), list[Mapping[str, Any]]()
    if as_json:
        files = [*walked]
        typer.echo(json.dumps(files, indent=1, ensure_ascii=False))
    elif inspection.is_store(path):
        counts, files = inspection.summarize(walked)
        typer.echo("\n".join(counts))
        for file in files[:MAX_NAMED]:
            typer.echo(f"BAD  {file['problem']}")
        if rest := len(files[MAX_NAMED:]):
            typer.echo(f"and {rest} more; --json names them")
    else:
        files = [*walked]
        for file in files:
            state = "BAD" if file["problem"] else file["spec"]
            typer.echo(f"{file['path']}: {state} {file['digest'][:12]}")
            typer.echo(f"  {file['problem'] or file['meaning']}")
            for name, value in {**file["fields"], **file["made"]}.items():
                typer.echo(f"  {name}: {value if isinstance(value, str) else json.dumps(value)}")
    raise typer.Exit(any(file["problem"] for file in files))


@store_app.command()
def gc(
    store: options.Store = None,
    yes: Annotated[bool, typer.Option("--yes", help="Remove files instead of listing.")] = False,
    age: Annotated[float, typer.Option(min=0, help="Days; more recent files stay.")] = 1.0,
) -> None:
    """List unreferenced files in a store, and remove them with --yes.

    Artifacts in a record stay, with their parts, so the next run finds all its results. Results of
    other versions of the stages, which this installation never reads, and temporary files of killed
    programs are removed too. Runs may continue meanwhile, as their files are more recent than
    --age.

    \b
    slgaussian store gc --store s3://bucket/slg --yes
    slgaussian store gc --age 7 --yes
    """
    from rich.filesize import decimal

    from slgaussian.storage.housekeeping import collect

    with _open_store(store) as opened:
        garbage = collect(opened, age * 86400, _stage_versions(), yes)
    kinds = {
        "artifacts that nothing refers to": garbage.artifacts,
        "records of other versions of the stages, or unreadable": garbage.records,
        "unfinished files": garbage.unfinished,
    }
    summary = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    size = f"; {decimal(garbage.bytes)}" if summary else ""
    typer.echo(f"{'removed' if yes else 'would be removed'}: {summary or 'nothing'}{size}")
    young = f", {garbage.young} others younger than {age:g} days" if garbage.young else ""
    typer.echo(f"stays: {garbage.kept} artifacts that are referred to{young}")
    if summary and not yes:
        typer.echo("nothing was removed: give --yes to do it")


@store_app.command()
@options.add_options("store")
def status(
    ctx: typer.Context,
    config: Annotated[Path, typer.Argument(help="TOML file of `run`, or of a corpus.")],
    as_json: options.AsJson = False,
) -> None:
    """List the results that a configuration lacks in its store, and the time to compute them.

    Computes nothing. Counts scenes by stage whose result is stored, missing, of an older version of
    the stage, or failed in the last run; later stages wait. A file with `sources`, as that of
    `retrain`, is looked up for lessons. The time is by the records of the store. The exit status is
    1 if anything is missing.

    \b
    slgaussian store status kitchen.toml
    slgaussian run kitchen.toml --only-missing
    """
    from flows.cli.run import prepare_prefect
    from flows.config import CorpusSettings, RetrainSettings, Settings
    from flows.read_config import read_toml, read_values
    from slgaussian.storage.backlog import as_text, summarise
    from slgaussian.storage.records import Records

    values = read_values(config, {})
    corpus = RetrainSettings if "models" in values else CorpusSettings
    model: Any = corpus if "sources" in values else Settings
    settings = read_toml(config, options.settings_from(ctx, model), model, "store status")
    with _open_store(settings.store) as opened:
        prepare_prefect(settings.store)
        from flows.runners.batches import FAILURES
        from flows.status import look_up

        failures, records = settings.out / FAILURES, Records(opened)
        backlog = summarise(look_up(settings, opened), failures, records, settings.workers)
    typer.echo(json.dumps(backlog, indent=1, ensure_ascii=False) if as_json else as_text(backlog))
    raise typer.Exit(bool(backlog["gaps"]))


@store_app.command()
def purge(
    clip: Annotated[list[str], typer.Option(help="Key of a clip; may be repeated.")] = [],  # noqa: B006
    place: Annotated[str | None, typer.Option(help="Place in the index of a --set.")] = None,
    store: options.Store = None,
    sets: Annotated[
        list[Path],
        typer.Option("--set", help="Training set, or folder of `ingest` or `supervise`."),
    ] = [],  # noqa: B006
    models: Annotated[list[Path], typer.Option(help="Folder of versions of weights.")] = [],  # noqa: B006
    yes: Annotated[bool, typer.Option("--yes", help="Remove them instead of listing.")] = False,
) -> None:
    """List all that is left of withdrawn clips, and remove it with --yes.

    From the store go all artifacts and records of the clips, and what was computed from them; from
    sets their samples, as a new version; from folders of `ingest` and `supervise` their rows and
    chunks. Then all is searched again. The exit status is 1 if something is left. Versions of
    weights that saw the clips are named. Other runs on the store must have ended.

    \b
    slgaussian store purge --clip office --set set --models models
    slgaussian store purge --place office --set set --set corpus --yes
    """
    from slgaussian.datasets import purge as purging
    from slgaussian.semantic.versions import Versions

    folders = [*sets, *models]
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder}: found no folder, expected one of results")
    clips = {*clip, *purging.find_clips(place, sets)}
    if not clips:
        raise InputError("give --clip, or a --place that the index of a --set has")
    with _open_store(store) as opened:
        traces = purging.find_traces(clips, opened, sets)
        for other in sorted(traces.clips - clips):
            typer.echo(f"{other}: has the same photographs, and counts as withdrawn too")
        if yes:
            purging.remove_traces(traces, opened, folders)
        searches = purging.search_all(traces, opened, folders)
    for where, count, files in searches:
        typer.echo(f"{where}: {count} files searched, {len(files)} have to do with the clips")
        for file in files:
            typer.echo(f"  {file}")
    for folder in models:
        for version in Versions(folder).find_trained_on(traces.clips):
            typer.echo(f"{folder}: version {version.number} was trained on them")
    is_left = any(files for _, _, files in searches)
    if is_left:
        typer.echo("they are left" if yes else "nothing was removed: give --yes to do it")
    elif not yes:
        typer.echo("there is nothing of them: they are gone, or their keys are others")
    typer.echo("give the clips as `withdrawn` from now on, or they come again from their sources")
    raise typer.Exit(int(is_left and yes))


@contextmanager
def _open_store(url: str | None) -> Iterator[ArtifactStore]:
    """Open an existing store; on a terminal, show that it is read."""
    from rich.console import Console

    from flows.read_config import make_settings
    from slgaussian.storage.store import ArtifactStore

    store = ArtifactStore(make_settings({} if url is None else {"store": url}, "store").store)
    if store.local and not Path(store.path).is_dir():
        raise InputError(f"{store.root}: found no folder, expected a store; say where with --store")
    with Console(stderr=True).status(f"reading {store.root}"):
        yield store


def _stage_versions() -> dict[str, int]:
    """Return the version of every stage that this installation has."""
    from importlib import import_module
    from pkgutil import iter_modules

    import tasks
    from tasks.stage import Stage

    modules = [import_module(f"tasks.{module.name}") for module in iter_modules(tasks.__path__)]
    stages = (v for module in modules for v in vars(module).values() if isinstance(v, Stage))
    return {stage.name: stage.version for stage in stages}
