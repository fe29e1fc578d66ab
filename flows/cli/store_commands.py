"""The commands `slgaussian store gc | verify | du`. Heavy imports wait until one is given."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli import options
from flows.cli.help import Group
from flows.cli.text import aligned
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.storage.store import ArtifactStore

DAY = 86400.0

store_app = typer.Typer(cls=Group, help="Look after a store: clean it, check it, measure it.")


@store_app.command()
def gc(
    store: options.Store = None,
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

    versions = _versions() if superseded else None
    with _opened(store) as (opened, tell):
        garbage = collect(opened, age * DAY, versions, keep or (), yes, tell)
    kinds = {
        "artifacts that nothing refers to": garbage.artifacts,
        "records that are superseded or unreadable": garbage.records,
        "unfinished files": garbage.unfinished,
    }
    some = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    size = f"; {size_text(garbage.bytes)}" if some else ""
    typer.echo(f"{'removed' if yes else 'would be removed'}: {some or 'nothing'}{size}")
    young = f", {garbage.young} others younger than {age:g} days" if garbage.young else ""
    typer.echo(f"stays: {garbage.kept} artifacts that are referred to{young}")
    if some and not yes:
        typer.echo("nothing was removed: give --yes to do it")


@store_app.command()
def verify(
    store: options.Store = None,
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
    from slgaussian.storage.housekeeping import verify as verify_store

    with _opened(store) as (opened, tell):
        found = verify_store(opened, remove, _versions(), tell)
    for reason in found.damaged.values():
        typer.echo(f"damaged: {reason}")
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
def du(store: options.Store = None) -> None:
    """Count the files and bytes in a store, by spec and stage.

    \b
    slgaussian store du
    slgaussian store du --store s3://bucket/slg
    """
    from slgaussian.storage.housekeeping import usage

    with _opened(store) as (opened, tell):
        rows = usage(opened, tell)
    total = [sum(column) for column in zip(*rows.values(), strict=True)] or [0, 0]
    lines = [["folder", "made by", "files", "size"]]
    for (folder, maker), (files, size) in [*rows.items(), (("all", ""), total)]:
        lines.append([folder or ".", maker or "-", f"{files}", size_text(size)])
    typer.echo(aligned(lines, "<<"))


def size_text(size: float) -> str:
    """Return bytes as people read them."""
    units = ["bytes", "kB", "MB", "GB", "TB"]
    while size >= 999.5 and len(units) > 1:
        size /= 1000
        del units[0]
    return f"{size:.0f} {units[0]}" if units[0] == "bytes" else f"{size:.3g} {units[0]}"


@contextmanager
def _opened(url: str | None) -> "Iterator[tuple[ArtifactStore, Callable[[str, int, int], None]]]":
    """Open a store; on a terminal, show how far a long walk through it is."""
    from rich.console import Console

    from flows.settings import make_settings
    from slgaussian.storage.store import ArtifactStore

    store = ArtifactStore(make_settings({} if url is None else {"store": url}, "store").store)
    if store.local and not Path(store.path).is_dir():
        raise InputError(f"{store.root}: found no folder, expected a store; say where with --store")
    counts, sizes = Counter[str](), Counter[str]()
    with Console(stderr=True).status(f"reading {store.root}") as status:

        def tell(kind: str, files: int, size: int) -> None:
            counts[kind] += files
            sizes[kind] += size
            status.update(f"{counts[kind]} {kind}, {size_text(sizes[kind])}")

        yield store, tell


def _versions() -> dict[str, int]:
    """Return the version of every stage that this installation has."""
    from importlib import import_module
    from pkgutil import iter_modules

    import tasks
    from tasks.stage import Stage

    modules = [import_module(f"tasks.{module.name}") for module in iter_modules(tasks.__path__)]
    found = (one for module in modules for one in vars(module).values() if isinstance(one, Stage))
    return {stage.name: stage.version for stage in found}
