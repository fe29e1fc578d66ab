"""The commands `slgaussian objects list | teach | name | remove | extract`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli import options
from flows.cli.help import Group
from flows.config import Method
from slgaussian.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from slgaussian.field import SemanticField
    from slgaussian.objects import SceneObject

EVEN = 0.5
"""Relevancy of what fits a text as well as it fits the canonical phrases."""

UNITS = {
    True: "Sizes are in metres.",
    False: "Sizes are in scene units, which are not metres: the cameras were found.",
    None: "Sizes are in scene units, those of the given cameras.",
}

Hits = tuple[tuple[int, float], ...]
"""Ids of objects with their relevancies."""

objects = typer.Typer(
    name="objects", cls=Group, help="List, teach, name, remove or extract objects."
)


@objects.command("list")
@options.configured()
def list_(
    ctx: typer.Context,
    field: options.Folder,
    texts: options.Texts = None,
    words: options.Words = None,
    out: options.Picture = None,
    as_json: options.AsJson = False,
) -> None:
    """List the objects of a field: words, size, place and views.

    Each has the words that fit it best, of all that the field knows or of the texts given; how
    clearly its pixels are its own (from 0 to 1); the size of the upright box around it, longer
    side, shorter side and height; and the views that hold it. --json has its centre and axes too.
    The exit status is 1 if a text is refused.

    \b
    slgaussian objects list field/
    slgaussian objects list field/ wall "red sofa" plant -o objects.png
    """
    from flows.cli.open_field import open_field, refusals, sort_texts
    from flows.cli.pictures import check_picture, write_picture
    from flows.cli.tables import table_text

    if out is not None:
        check_picture(out)
    rules, opened = open_field(field, options.settings_from(ctx, Method), words)
    accepted, refused = sort_texts(opened, texts or [], untold=False)
    things = opened.inventory(accepted or None, **rules)
    if out is not None:
        write_picture(out, _picture(field, opened, things))
    rows = [_row(thing) for thing in things]
    notes = [{"text": text, "refused": reason} for text, reason in refused.items()]
    if as_json:
        typer.echo("\n".join(map(json.dumps, [*rows, *notes])))
    else:
        lines = [("object", "best words", "sure", "size", "seen in"), *map(_cells, rows)]
        typer.echo(table_text(lines, "><><<"))
        if any(row["relevancies"][:1] <= [EVEN] for row in rows):
            typer.echo("(in brackets: no text fits better than the canonical phrases do)")
        if things:
            typer.echo(UNITS[things[0].metres])
        for line in refusals(notes):
            typer.echo(line)
    raise typer.Exit(1 if refused else 0)


@objects.command()
def teach(
    field: options.Folder,
    word: Annotated[str, typer.Argument(metavar="WORD", help='What you call it, as "fox".')],
    at: Annotated[
        tuple[int, int] | None, typer.Option(metavar="X Y", help="Column and row of its pixel.")
    ] = None,
    view: options.View = None,
    forget: Annotated[bool, typer.Option("--forget", help="Forget the word.")] = False,
) -> None:
    """Teach a field a word of your own by pointing at a thing.

    The word is kept in the field, and asked like any other. Point again, at other things or in
    other views, for more examples. Other fields of the same place take the words with
    --words field/words.npz.

    \b
    slgaussian objects teach field/ fox --at 312 140
    slgaussian objects teach field/ fox --at 80 210 --view 1
    slgaussian objects teach field/ fox --forget
    """
    from flows.cli.open_field import choose_cameras
    from slgaussian.field import SemanticField

    if forget == (at is not None):
        raise InputError("say either where it is, with --at X Y, or --forget")
    opened = SemanticField.load(field)
    if at is None:
        opened.forget(word).save_edits(field)
        typer.echo(f"{word!r} is forgotten")
        return
    ((name, camera),) = choose_cameras(field, opened.cameras, view and [view]).items()
    (x, y), (width, height) = at, (camera.width, camera.height)
    if not (0 <= x < width and 0 <= y < height):
        raise InputError(
            f"--at {x} {y}: is outside view {name!r}, which is {width} pixels wide and "
            f"{height} high"
        )
    id_ = int(opened.render(camera).ids[y, x])
    if not id_:
        raise InputError(
            f"--at {x} {y}: view {name!r} shows no object there; point at one, which "
            "`slgaussian render` draws"
        )
    taught = opened.teach(word, id_)
    taught.save_edits(field)
    typer.echo(f"{word!r} is object {id_}\nexamples  {taught.taught.examples(word)}")
    typer.echo(f"it means  {_listed(taught.find(word))}")


@objects.command()
def name(
    field: options.Folder,
    id_: Annotated[int, typer.Argument(metavar="ID", help="The object, as `objects list` has it.")],
    name: Annotated[str | None, typer.Argument(help="Its name; left out, it has none.")] = None,
) -> None:
    """Give an object a name that can be asked, or take it away.

    \b
    slgaussian objects name field/ 17 "my chair"
    slgaussian objects name field/ 17
    """
    from slgaussian.field import SemanticField

    edited = SemanticField.load(field).named(id_, name or "")
    edited.save_edits(field)
    name = edited.names.get(id_)
    typer.echo(f"object {id_} has no name" if name is None else f"object {id_} is {name!r}")


@objects.command()
@options.configured()
def remove(
    ctx: typer.Context,
    field: options.Folder,
    texts: Annotated[list[str], typer.Argument(metavar="OBJECT", help="Texts, names, or ids.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field without it.")],
    words: options.Words = None,
) -> None:
    """Write a field again without some of its things.

    What was behind is shown where another view saw it. Where none did, nothing is painted: pictures
    have grey stripes there. The exit status is 3 if nothing is found for any text; what is found of
    the others is removed.

    \b
    slgaussian objects remove field/ "red chair" -o without/
    slgaussian render without/ -o picture.png
    """
    import numpy as np

    from flows.cli.open_field import open_field
    from slgaussian.storage.field_folder import check_target

    if out.resolve() == field.resolve():
        raise InputError(
            f"{out}: is the field itself, and what is removed does not come back; choose another "
            "folder"
        )
    check_target(out)
    rules, opened = open_field(field, options.settings_from(ctx, Method), words)
    hits = {text: find_objects(opened, text, rules) for text in texts}
    labels, removed = opened.labels(), set[int]()
    for text, meant in hits.items():
        ids = {id_ for id_, _ in meant} - removed
        removed |= ids
        count = int(np.isin(labels, list(ids)).sum())
        meaning = f"objects {_listed(meant)}" if meant else "nothing found"
        typer.echo(f"{text!r}: {meaning}, {count:,} Gaussians")
    if removed:
        opened.without(removed).dropped().save(out)
        typer.echo(out)
    raise typer.Exit(0 if all(hits.values()) else 3)


@objects.command()
@options.configured()
def extract(
    ctx: typer.Context,
    field: options.Folder,
    text: Annotated[str, typer.Argument(metavar="OBJECT", help="A text, a name, or an id.")],
    out: Annotated[Path, typer.Option("--out", "-o", help=".ply file, or folder for a field.")],
    words: options.Words = None,
) -> None:
    """Take a thing out of a field, alone.

    A text takes the objects that a query would take, in whatever view. The exit status is 3 if the
    scene as a whole does not hold it, by the verdict of `query`; then nothing is written.

    \b
    slgaussian objects extract field/ "red chair" -o chair.ply
    slgaussian objects extract field/ 17 -o chair/
    """
    from flows.cli.open_field import open_field
    from slgaussian.formats.ply import save_ply
    from slgaussian.storage.field_folder import check_target

    ply = out.suffix.lower() == ".ply"
    if not ply:
        check_target(out)
    rules, opened = open_field(field, options.settings_from(ctx, Method), words)
    hits = find_objects(opened, text, rules)
    alone = opened.dropped().only(id_ for id_, _ in hits)
    if not len(alone.gaussians):
        typer.echo(f"nothing found for {text!r}, so nothing is written")
        raise typer.Exit(3)
    if ply:
        save_ply(alone.gaussians, out, alone.labels())
    else:
        alone.save(out)
    typer.echo(f"objects  {_listed(hits)}\n{len(alone.gaussians):,} Gaussians  {out}")


def find_objects(field: SemanticField, text: str, rules: Mapping[str, Any]) -> Hits:
    """Return the objects that a text means: that of this id, those of this name, or those it fits.

    None where the scene as a whole answers the text with "not here" or "cannot tell".
    """
    import numpy as np

    from slgaussian.language.objectmap import ObjectMap
    from slgaussian.language.query import Rules, ask

    there = {int(id_) for id_ in field.bank.ids} - field.removed
    if text.strip().isdecimal():
        if int(text) not in there:
            raise InputError(
                f"{text!r}: is no object of the field; `slgaussian objects list` has them"
            )
        return ((int(text), 1.0),)
    labels = field.labels()
    labels = np.where(np.isin(labels, list(field.removed)), 0, labels)
    seen = ObjectMap(labels[None], field.bank.ids)
    (answer,) = ask([text], seen, field.reader, Rules(**rules))
    return field.find(text, **rules) if answer.shown else ()


def _listed(hits: Hits) -> str:
    return ", ".join(f"{id_} ({score:.3f})" for id_, score in hits)


def _row(thing: SceneObject) -> dict[str, Any]:
    """Return what ``--json`` prints of an object.

    ``words`` are best first, with their ``relevancies``. ``centre`` [3], ``axes`` [9] (longer side,
    shorter side and up) and ``half_sizes`` [3] of its box are in scene units, None without
    Gaussians. ``metres`` as :class:`slgaussian.objects.SceneObject` has it.
    """
    box = thing.box
    return {
        "id": thing.id,
        "name": thing.name,
        "words": [text for text, _ in thing.words],
        "relevancies": [relevancy for _, relevancy in thing.words],
        "confidence": thing.confidence,
        "gaussians": thing.gaussians,
        "centre": None if box is None else box.centre.tolist(),
        "axes": None if box is None else box.axes.ravel().tolist(),
        "half_sizes": None if box is None else box.half_sizes.tolist(),
        "metres": thing.metres,
        "views": list(thing.views),
    }


def _cells(row: Mapping[str, Any]) -> Sequence[str]:
    pairs = list(zip(row["words"], row["relevancies"], strict=True))
    fitting = [f"{text} {relevancy:.3f}" for text, relevancy in pairs if relevancy > EVEN]
    words = ", ".join(fitting or [f"({text} {r:.3f})" for text, r in pairs[:1]])
    if row["name"] is not None:
        words = f"{row['name']!r}: {words}"
    size = " x ".join(f"{2 * half:.2f}" for half in row["half_sizes"] or ())
    return str(row["id"]), words, f"{row['confidence']:.2f}", size, ", ".join(row["views"])


def _picture(folder: Path, field: SemanticField, things: Sequence[SceneObject]) -> np.ndarray:
    """Draw how each object looks in the view that shows most of it."""
    import numpy as np

    from slgaussian.benchmark import pictures

    if field.bank.boxes is None:
        raise InputError(
            f"{folder}: its memory bank does not know where the objects are, so they cannot be "
            "drawn; leave out the picture, or build the field again"
        )
    views = [field.render(camera) for camera in field.cameras.values()]
    rows = np.searchsorted(field.bank.ids, [thing.id for thing in things])
    ids, boxes = field.bank.ids[rows], field.bank.boxes[rows]
    cuts = pictures.cut_out([v.rgb for v in views], [v.ids for v in views], ids, boxes)
    tiles = []
    for thing, cut in zip(things, cuts, strict=True):
        fits = thing.words and thing.words[0][1] > EVEN
        called = thing.name or (thing.words[0][0] if fits else "")
        tiles.append((f"{thing.id} {called}".strip(), cut))
    return pictures.contact_sheet(tiles, side=112, columns=8)
