"""The commands `slgaussian objects list | teach | name | remove | extract`."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.help import Group
from flows.cli.options import settings_from

objects = typer.Typer(
    cls=Group, help="List the objects of a field; teach, name, remove or extract them."
)

Folder = Annotated[Path, typer.Argument(metavar="FIELD", help="Folder that `field` wrote.")]
Meant = Annotated[
    str,
    typer.Argument(metavar="OBJECT", help="A text, a name that you gave, or the id of an object."),
]
Words = Annotated[
    Path | None,
    typer.Option(metavar="<path>", help="Words taught elsewhere: words.npz of another field."),
]


@objects.command("list")
def list_(
    ctx: typer.Context,
    field: Folder,
    texts: Annotated[
        list[str] | None,
        typer.Argument(metavar="TEXT", help="What to tell objects by. [default: what is known]"),
    ] = None,
    words: Words = None,
    set_: options.Set = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Table (.parquet), or picture of all (.png).")
    ] = None,
    crops: Annotated[
        Path | None, typer.Option(metavar="<path>", help="Folder for a picture of each: ID.png.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """List the objects of a field: words, size, place and views.

    Each has the words that fit it best, of all that the field knows or of the texts given; how
    clearly its pixels are its own (from 0 to 1); the size of the upright box around it, longer
    side, shorter side and height; and the views that hold it. The table and --json have its centre
    and axes too. The exit status is 1 if a text is refused.

    \b
    slgaussian objects list field/
    slgaussian objects list field/ wall "red sofa" plant -o objects.png
    slgaussian objects list field/ -o objects.parquet --crops things/
    """
    import json

    from flows.cli.objects import inventory, objects_table

    rows = inventory(field, texts or [], out, crops, settings_from(ctx), words)
    typer.echo("\n".join(map(json.dumps, rows)) if as_json else objects_table(rows))
    if any(row.get("refused") for row in rows):
        raise typer.Exit(1)


@objects.command()
def teach(
    field: Folder,
    word: Annotated[str, typer.Argument(metavar="WORD", help='What you call it, as "fox".')],
    at: Annotated[
        tuple[int, int] | None,
        typer.Option(metavar="X Y", help="Pixel of the thing: column and row from the top left."),
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(metavar="<name>", help="View of that pixel, by name or number. [default: 0]"),
    ] = None,
    forget: Annotated[bool, typer.Option("--forget", help="Forget the word.")] = False,
) -> None:
    """Teach a field a word of your own by pointing at a thing.

    The word is kept in the field, and asked like any other. Point again, at other things or in
    other views, for more examples. Other fields of the same place take the words with
    --words field/words.npz.

    \b
    slgaussian objects teach field/ fox --at 312 140
    slgaussian objects teach field/ fox --at 80 210 --view 1
    slgaussian query field/ fox -o hit.png
    slgaussian objects teach field/ fox --forget
    """
    from flows.cli.objects import teach_word

    typer.echo(teach_word(field, word, at, view, forget))


@objects.command()
def name(
    field: Folder,
    id_: Annotated[int, typer.Argument(metavar="ID", help="The object, as `objects list` has it.")],
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Its name; left out, it has none.")
    ] = None,
) -> None:
    """Give an object a name that can be asked, or take it away.

    \b
    slgaussian objects name field/ 17 "my chair"
    slgaussian query field/ "my chair"
    slgaussian objects name field/ 17
    """
    from slgaussian.field import SemanticField

    edited = SemanticField.load(field).named(id_, name or "")
    edited.save_edits(field)
    name = edited.names.get(id_)
    typer.echo(f"object {id_} has no name" if name is None else f"object {id_} is {name!r}")


@objects.command()
def remove(
    ctx: typer.Context,
    field: Folder,
    meant: Annotated[
        list[str],
        typer.Argument(metavar="OBJECT", help="Texts, names that you gave, or ids of objects."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field without it.")],
    words: Words = None,
    set_: options.Set = None,
) -> None:
    """Write a field again without some of its things.

    What was behind is shown where another view saw it. Where none did, nothing is painted: pictures
    have grey stripes there. The exit status is 3 if nothing is found for any text; what is found of
    the others is removed.

    \b
    slgaussian objects remove field/ "red chair" -o without/
    slgaussian render without/ -o picture.png
    """
    from flows.cli.objects import write_without

    if not write_without(field, meant, out, settings_from(ctx), words):
        raise typer.Exit(3)


@objects.command()
def extract(
    ctx: typer.Context,
    field: Folder,
    meant: Meant,
    out: Annotated[Path, typer.Option("--out", "-o", help=".ply file, or folder for a field.")],
    words: Words = None,
    set_: options.Set = None,
) -> None:
    """Take a thing out of a field, alone.

    A text takes the objects that a query would take, in whatever view. The exit status is 3 if the
    scene as a whole does not hold it, by the verdict of `query`; then nothing is written.

    \b
    slgaussian objects extract field/ "red chair" -o chair.ply
    slgaussian objects extract field/ 17 -o chair/
    """
    from flows.cli.objects import write_alone

    if not write_alone(field, meant, out, settings_from(ctx), words):
        raise typer.Exit(3)
