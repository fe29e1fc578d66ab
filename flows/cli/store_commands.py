"""The commands `slgaussian store gc | verify | du`. Heavy imports wait until one is given."""

import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from flows.cli.help import App
from flows.cli.options import with_options
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.storage.store import ArtifactStore

DAY = 86400.0

store_app = App(
    help="Look after a store: clean it, check it, measure it.",
)


@store_app.command()
@with_options("store")
def gc(
    settings: dict,
    yes: Annotated[
        bool, typer.Option("--yes", help="Remove it. Otherwise it is only listed.")
    ] = False,
    age: Annotated[
        float, typer.Option(help="Days; what was written since then stays, whatever it is.")
    ] = 1.0,
    superseded: Annotated[
        bool,
        typer.Option(
            "--superseded",
            help="Also results of other versions of the stages than those of this installation.",
        ),
    ] = False,
    keep: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="<path>",
            help="Table such as lessons.parquet; what it names stays. May be repeated.",
        ),
    ] = None,
) -> None:
    """Say what nothing in a store refers to, and remove it with --yes.

    What a record names stays, with its parts: so does all that the next run would find. Files that
    a killed program left half-written go too. A run may go on meanwhile: what it makes is younger
    than --age.

    \b
    slgaussian store gc
    slgaussian store gc --store s3://bucket/slg --yes
    slgaussian store gc --superseded --keep corpus/lessons.parquet --age 7 --yes
    """
    if age < 0:
        raise InputError(f"--age: found {age:g}, expected a number of days from 0")
    from slgaussian.storage.housekeeping import collect

    store, watch = _open(settings), _Watch()
    versions = _versions() if superseded else None
    found = collect(store, age * DAY, versions, keep or (), yes, watch)
    watch.end()
    kinds = {
        "artifacts that nothing refers to": found.artifacts,
        "records that are superseded or unreadable": found.records,
        "unfinished files": found.unfinished,
        "unfinished uploads": found.uploads,
    }
    told = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    done = "removed" if yes else "would be removed"
    typer.echo(f"{done}: {told or 'nothing'}" + (f"; {told_size(found.bytes)}" if told else ""))
    young = f", {found.young} others younger than {age:g} days" if found.young else ""
    typer.echo(f"stays: {found.kept} artifacts that are referred to{young}")
    if told and not yes:
        typer.echo("nothing was removed: give --yes to do it")


@store_app.command()
@with_options("store")
def verify(
    settings: dict,
    remove: Annotated[
        bool, typer.Option("--remove", help="Delete what is damaged: it is then made again.")
    ] = False,
) -> None:
    """Read everything in a store, and name what is damaged.

    Each file is compared with its spec and digest. The exit status is 1 if something is damaged
    and stays.

    \b
    slgaussian store verify
    slgaussian store verify --store s3://bucket/slg --remove
    """
    from slgaussian.storage.housekeeping import verify as look

    store, watch = _open(settings), _Watch()
    found = look(store, remove, _versions(), watch)
    watch.end()
    for why in found.damaged.values():
        typer.echo(f"damaged: {why}")
    done = " and removed: the next run makes them again" if found.damaged and remove else ""
    typer.echo(f"{found.sound} artifacts are whole, {len(found.damaged)} files are damaged{done}")
    if found.missing:
        typer.echo(
            f"{found.missing} artifacts are not there any more; a run that needs one makes it"
        )
    if found.superseded:
        typer.echo(
            f"{found.superseded} artifacts were made by other versions of the stages, and nothing "
            "reads them any more; `slgaussian store gc --superseded` removes them"
        )
    if found.damaged and not remove:
        typer.echo("give --remove to delete them: the next run makes them again")
        raise typer.Exit(1)


@store_app.command()
@with_options("store")
def du(settings: dict) -> None:
    """Count the files and bytes in a store, by spec and stage.

    \b
    slgaussian store du
    slgaussian store du --store s3://bucket/slg
    """
    from slgaussian.storage.housekeeping import usage

    store, watch = _open(settings), _Watch()
    rows = usage(store, watch)
    watch.end()
    typer.echo(_table(rows))


def told_size(size: float) -> str:
    """Bytes as people read them."""
    units = ["bytes", "kB", "MB", "GB", "TB"]
    while size >= 999.5 and len(units) > 1:
        size /= 1000
        del units[0]
    return f"{size:.0f} {units[0]}" if units[0] == "bytes" else f"{size:.3g} {units[0]}"


def _table(rows: dict[tuple[str, str], list[int]]) -> str:
    whole = [sum(column) for column in zip(*rows.values(), strict=True)] or [0, 0]
    lines = [["folder", "made by", "files", "size"]]
    for (folder, maker), (files, size) in [*rows.items(), (("all", ""), whole)]:
        lines.append([folder or ".", maker or "-", f"{files}", told_size(size)])
    wide = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        f"{a:<{wide[0]}}  {b:<{wide[1]}}  {c:>{wide[2]}}  {d:>{wide[3]}}" for a, b, c, d in lines
    )


class _Watch:
    """Says every now and then, on standard error, how far a long walk through a store is."""

    EVERY = 0.5
    """Seconds between two changes of the live line; on no terminal a line is said every 30."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = stream or sys.stderr
        self.live = self.stream.isatty()
        self.last = time.monotonic()
        self.counts: Counter[str] = Counter()
        self.bytes: Counter[str] = Counter()

    def __call__(self, what: str, files: int, size: int) -> None:
        self.counts[what] += files
        self.bytes[what] += size
        now = time.monotonic()
        if now - self.last < (self.EVERY if self.live else 30.0):
            return
        self.last = now
        told = f"{self.counts[what]} {what}, {told_size(self.bytes[what])}"
        self.stream.write(f"\r\x1b[2K{told}" if self.live else f"{told}\n")
        self.stream.flush()

    def end(self) -> None:
        """Take the live line away."""
        if self.live:
            self.stream.write("\r\x1b[2K")


def _open(settings: dict) -> "ArtifactStore":
    from flows.settings import make_settings
    from slgaussian.storage.store import ArtifactStore

    store = ArtifactStore(make_settings(settings, "store").store)
    if store.local and not Path(store.path).is_dir():
        raise InputError(f"{store.root}: found no folder, expected a store; say where with --store")
    return store


def _versions() -> dict[str, int]:
    """The version of every stage that this installation has."""
    from importlib import import_module
    from pkgutil import iter_modules

    import tasks
    from tasks.stage import Stage

    modules = [import_module(f"tasks.{module.name}") for module in iter_modules(tasks.__path__)]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Stage))
    return {stage.name: stage.version for stage in found}
