"""The commands `slgaussian objects list | teach | name | remove | extract`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli import options
from slgaussian.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from slgaussian.field import SemanticField
    from slgaussian.objects import SceneObject

MAX_LISTED = 20
"""Number of listed objects, those with most Gaussians."""

MAX_QUERIED_VIEWS = 4
"""Largest number of context views in which words are queried."""

SIZE_UNITS = {
    True: "Sizes are in metres.",
    False: "Sizes are in scene units, which are not metres: the cameras were estimated.",
    None: "Sizes are in scene units, those of the given cameras.",
}

Hits = tuple[tuple[int, float], ...]
"""Ids of objects with their relevancies."""

objects = typer.Typer(
    name="objects",
    cls=options.Group,
    no_args_is_help=True,
    help="List, teach, name, remove or extract objects.",
)


@objects.command("list")
@options.add_options()
def list_(
    ctx: typer.Context,
    field: options.Folder,
    texts: options.Texts = None,
    out: options.Picture = None,
    show_all: Annotated[
        bool, typer.Option("--all", help="List all objects, not only the largest.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """List the twenty largest objects of a field: words, size and views.

    For each object, prints the words, of all known words or of the given texts, with which a query
    finds it, or in brackets the best word; the confidence of its segmentation (0 to 1); the size of
    its upright bounding box (longer side, shorter side, height); and the views that show it. --json
    has all objects, with the best words, centres and axes. The exit status is 1 if some texts
    are refused, 2 if all are.

    \b
    slgaussian objects list field/
    slgaussian objects list field/ wall "red sofa" plant -o objects.png
    """
    from flows.cli.open_field import open_field, refusals, sort_texts
    from flows.cli.pictures import check_picture, write_picture
    from slgaussian.benchmark.reports.text_table import table_text

    if out is not None:
        check_picture(out)
    rules, opened = open_field(field, ctx)
    accepted, refused = sort_texts(opened, texts or [], untold=False)
    things = opened.inventory(accepted or None, **rules)
    largest = sorted(things, key=lambda thing: -thing.gaussians)
    listed = largest if show_all else largest[:MAX_LISTED]
    reliable = {} if as_json and out is None else _sure_words(opened, accepted, rules)
    if out is not None:
        write_picture(out, _picture(field, opened, listed, reliable))
    notes = [{"text": text, "refused": reason} for text, reason in refused.items()]
    if as_json:
        typer.echo("\n".join(map(json.dumps, [*map(_row, things), *notes])))
    else:
        rows = [_cells(thing, reliable.get(thing.id, [])) for thing in listed]
        typer.echo(table_text([("object", "words", "clear", "size", "seen in"), *rows], "><><<"))
        if any(words.startswith("(") for _, words, *_ in rows):
            typer.echo("(in brackets: the word that fits best; a query for it is not sure)")
        if listed:
            typer.echo(SIZE_UNITS[listed[0].metres])
        if largest[len(listed) :]:
            typer.echo(f"{len(largest) - len(listed)} smaller ones are listed with --all")
        for line in refusals(notes):
            typer.echo(line)
    raise typer.Exit(1 if refused else 0)


@objects.command()
def teach(
    field: options.Folder,
    word: Annotated[str, typer.Argument(metavar="WORD", help='The word, such as "fox".')],
    at: Annotated[
        tuple[int, int] | None, typer.Option(metavar="X Y", help="Column and row of a pixel of it.")
    ] = None,
    view: options.View = None,
    forget: Annotated[bool, typer.Option("--forget", help="Forget the word.")] = False,
) -> None:
    """Teach a field a new word by pointing at an object.

    The word is stored in the field, and queried like any other. Point at more objects or in other
    views to add examples.

    \b
    slgaussian objects teach field/ fox --at 312 140
    slgaussian objects teach field/ fox --at 80 210 --view 1
    slgaussian objects teach field/ fox --forget
    """
    from flows.cli.open_field import choose_cameras
    from slgaussian.field import SemanticField

    if forget == (at is not None):
        raise InputError("give either the position of an example, --at X Y, or --forget")
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
    typer.echo(f"{word!r} is object {id_}\nexamples  {taught.edits.taught.examples(word)}")
    typer.echo(f"it means  {_format_hits(taught.find(word))}")


@objects.command()
def name(
    field: options.Folder,
    id_: Annotated[int, typer.Argument(metavar="ID", help="Id of the object, see `objects list`.")],
    name: Annotated[
        str | None, typer.Argument(help="Its name; without one, it is removed.")
    ] = None,
) -> None:
    """Give an object a name for queries, or remove its name.

    \b
    slgaussian objects name field/ 17 "my chair"
    slgaussian objects name field/ 17
    """
    from slgaussian.field import SemanticField

    edited = SemanticField.load(field).rename(id_, name or "")
    edited.save_edits(field)
    name = edited.edits.names.get(id_)
    typer.echo(f"object {id_} has no name" if name is None else f"object {id_} is {name!r}")


@objects.command()
@options.add_options()
def remove(
    ctx: typer.Context,
    field: options.Folder,
    texts: Annotated[list[str], typer.Argument(metavar="OBJECT", help="Texts, names, or ids.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field without it.")],
) -> None:
    """Write a copy of a field without some of its objects.

    Surfaces behind a removed object are visible if another view shows them, else renderings have
    grey stripes there. The exit status is 3 if one text finds nothing; the objects of the other
    texts are removed.

    \b
    slgaussian objects remove field/ "red chair" -o without/
    slgaussian render without/ -o picture.png
    """
    import numpy as np

    from flows.cli.open_field import open_field
    from slgaussian.storage.field_folder import check_target

    if out.resolve() == field.resolve():
        raise InputError(
            f"{out}: is the field itself, and removal cannot be undone; choose another folder"
        )
    check_target(out)
    rules, opened = open_field(field, ctx)
    hits = {text: find_objects(opened, text, rules) for text in texts}
    labels, removed = opened.labels(), set[int]()
    for text, objects in hits.items():
        ids = {id_ for id_, _ in objects} - removed
        removed |= ids
        meaning = f"objects {_format_hits(objects)}" if objects else "nothing found"
        typer.echo(f"{text!r}: {meaning}, {np.isin(labels, list(ids)).sum():,} Gaussians")
    if removed:
        opened.without(removed).drop_hidden().save(out)
        typer.echo(out)
    raise typer.Exit(0 if all(hits.values()) else 3)


@objects.command()
@options.add_options()
def extract(
    ctx: typer.Context,
    field: options.Folder,
    text: Annotated[str, typer.Argument(metavar="OBJECT", help="A text, a name, or an id.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File that `export` writes, or folder for a field.")
    ],
) -> None:
    """Write the objects of a query alone, as a field or a file that `export` writes.

    A text selects objects as `query` does, but in the whole scene instead of a view. The exit
    status is 3 if the verdict is "not here" or "cannot tell"; then nothing is written.

    \b
    slgaussian objects extract field/ "red chair" -o chair.ply
    slgaussian objects extract field/ 17 -o chair/
    """
    from flows.cli.open_field import open_field
    from slgaussian.formats.splats import WRITERS, save_gaussians
    from slgaussian.storage.field_folder import check_target

    is_file = out.suffix.lower() in WRITERS
    if not is_file:
        check_target(out)
    rules, opened = open_field(field, ctx)
    hits = find_objects(opened, text, rules)
    extracted = opened.drop_hidden().only(id_ for id_, _ in hits)
    if not len(extracted.gaussians):
        typer.echo(f"nothing found for {text!r}, so nothing is written")
        raise typer.Exit(3)
    if is_file:
        save_gaussians(extracted.gaussians, out, extracted.labels(), extracted.cameras)
    else:
        extracted.save(out)
    typer.echo(f"objects  {_format_hits(hits)}\n{len(extracted.gaussians):,} Gaussians  {out}")


def find_objects(field: SemanticField, text: str, rules: Mapping[str, Any]) -> Hits:
    """Return the objects of a text, which is an id, a name or a query.

    None if the verdict in the whole scene is "not here" or "cannot tell".
    """
    import numpy as np

    from slgaussian.language.answer import ask
    from slgaussian.language.objectmap import ObjectMap
    from slgaussian.language.rules import Rules

    if text.strip().isdecimal():
        if int(text) not in set(field.bank.ids.tolist()) - field.edits.removed:
            raise InputError(
                f"{text!r}: is no object of the field; `slgaussian objects list` lists them"
            )
        return ((int(text), 1.0),)
    labels = field.labels()
    labels = np.where(np.isin(labels, list(field.edits.removed)), 0, labels)
    object_map = ObjectMap(labels[None], field.bank.ids)
    (answer,) = ask([text], object_map, field.reader, Rules(**rules))
    return field.find(text, **rules) if answer.shown else ()


def _format_hits(hits: Hits) -> str:
    return ", ".join(f"{id_} ({score:.3f})" for id_, score in hits)


def _row(thing: SceneObject) -> dict[str, Any]:
    """Return the JSON output of an object, see :class:`slgaussian.objects.SceneObject`.

    The centre [3], axes [9] and half sizes [3] of its box are None without Gaussians.
    """
    box = {
        name: None if thing.box is None else getattr(thing.box, name).ravel().tolist()
        for name in ("centre", "axes", "half_sizes")
    }
    return {
        "id": thing.id,
        "name": thing.name,
        "words": [text for text, _ in thing.words],
        "relevancies": [relevancy for _, relevancy in thing.words],
        "confidence": thing.confidence,
        "gaussians": thing.gaussians,
        **box,
        "metres": thing.metres,
        "views": list(thing.views),
    }


def _sure_words(
    field: SemanticField, texts: Sequence[str], rules: Mapping[str, Any]
) -> dict[int, list[str]]:
    """Return the words whose query finds each object in a context view, most confident first."""
    texts = texts or field.encoder.describing
    candidate_texts = list(dict.fromkeys([*field.edits.taught, *texts]))
    surest: dict[tuple[int, str], float] = {}
    for camera in list(field.cameras.values())[:MAX_QUERIED_VIEWS]:
        hits = field.render(camera).query_all(candidate_texts, **rules)
        for hit in (hit for hit in hits if hit.found):
            mask = 1.0 if hit.confidence is None else hit.confidence.mask
            for key in ((id_, hit.text) for id_, _ in hit.objects):
                surest[key] = max(mask, surest.get(key, 0.0))
    words: dict[int, list[str]] = {}
    for id_, text in sorted(surest, key=lambda key: -surest[key]):
        words.setdefault(id_, []).append(text)
    return words


def _cells(thing: SceneObject, reliable: Sequence[str]) -> Sequence[str]:
    words = ", ".join(reliable) or ", ".join(f"({text})" for text, _ in thing.words[:1])
    if thing.name is not None:
        words = f"{thing.name!r}: {words}"
    size = "" if thing.box is None else " x ".join(f"{2 * x:.2f}" for x in thing.box.half_sizes)
    return str(thing.id), words, f"{thing.confidence:.2f}", size, ", ".join(thing.views)


def _picture(
    folder: Path,
    field: SemanticField,
    things: Sequence[SceneObject],
    reliable: Mapping[int, Sequence[str]],
) -> np.ndarray:
    """Draw each object in the view that shows most of it."""
    import numpy as np

    from slgaussian.benchmark import pictures

    if field.bank.boxes is None:
        raise InputError(
            f"{folder}: its memory bank has no bounding boxes, so objects cannot be drawn; leave "
            "out the picture, or build the field again"
        )
    views = [field.render(camera) for camera in field.cameras.values()]
    ids = np.array([thing.id for thing in things])
    boxes = field.bank.boxes[np.searchsorted(field.bank.ids, ids)]
    cuts = pictures.cut_out([v.rgb for v in views], [v.ids for v in views], ids, boxes)
    names = (thing.name or next(iter(reliable.get(thing.id, ())), "") for thing in things)
    titles = [f"{id_} {name}".strip() for id_, name in zip(ids, names, strict=True)]
    return pictures.contact_sheet(list(zip(titles, cuts, strict=True)), side=112, columns=8)
