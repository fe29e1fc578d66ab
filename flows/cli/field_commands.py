"""The commands about one field. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.command_settings import COMMON, FIELDS, PLACES, RULES
from flows.cli.help import App
from flows.cli.options import with_options
from slgaussian.errors import InputError

commands = App()

Folder = Annotated[
    Path, typer.Argument(metavar="FIELD", help="Folder that `field` wrote, or OUT/fields/SCENE.")
]
Texts = Annotated[
    list[str], typer.Argument(metavar="TEXT", help='What to look for, as "red basket".')
]
MaybeTexts = Annotated[
    list[str] | None, typer.Argument(metavar="TEXT", help='What to look for, as "red basket".')
]
What = Annotated[
    str,
    typer.Argument(metavar="WHAT", help="A text, a name that you gave, or the id of an object."),
]
Words = Annotated[
    Path | None,
    typer.Option(metavar="<path>", help="Words taught elsewhere: words.npz of another field."),
]
Views = Annotated[
    list[str] | None,
    typer.Option(
        "--view",
        metavar="<name>",
        help="Look from this view, by name or number from 0; may be repeated. [default: 0]",
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        "--cameras",
        help="Look from cameras of your own: one as JSON, or a transforms.json.",
    ),
]
Between = Annotated[
    tuple[str, str, float] | None,
    typer.Option(
        metavar="A B T", help="Look from share T, 0 to 1, of the way from view A to view B."
    ),
]
Orbit = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="Look from N places on a short turn; for -o turn.mp4 or turn.gif."
    ),
]
Picture = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Picture of the answer: .png or .jpg."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print each answer as a line of JSON.")]


@commands.command(rich_help_panel=FIELDS)
@with_options("preset", *RULES, *PLACES, common=COMMON["query"])
def query(
    settings: dict,
    field: Folder,
    texts: MaybeTexts = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(metavar="<path>", help="Look for what a picture shows; may be repeated."),
    ] = None,
    view: Views = None,
    between: Between = None,
    camera: CameraFile = None,
    orbit: Orbit = None,
    words: Words = None,
    out: Picture = None,
    as_json: AsJson = False,
) -> None:
    """Ask a field where something is, in words or by a picture.

    Takes the objects that fit the text about as well as the best one does, and none if no object
    fits better than canonical phrases ("object", "things" ...). With --threshold, takes all above.
    Says how likely that is right. The exit status is 0 if each text is found in a view, 3 if one is
    not sure or not here in all, 1 if one is refused.

    \b
    slgaussian query field/ "red basket" -o hit.png
    slgaussian query field/ "blue carpet" "wooden table" --view 0 --view 1 --json
    slgaussian query field/ "red basket" --between 0 1 0.5 -o hit.jpg
    slgaussian query field/ "red basket" --orbit 60 -o turn.mp4
    slgaussian query field/ fox --words other_field/words.npz
    slgaussian query field/ --like crop.png -o hit.png
    """
    import json

    from flows.cli import questions
    from flows.cli.viewpoints import Choice

    if not texts and not like:
        raise InputError("nothing is asked: give a TEXT, or a picture with --like")
    choice = Choice(view or (), camera, between, orbit)
    answers = questions.ask(field, texts or [], choice, out, settings, words, like or ())
    said = questions.spoken_film(answers) if choice.film else questions.spoken(answers)
    typer.echo("\n".join(map(json.dumps, answers)) if as_json else said)
    if out is not None and not as_json:
        typer.echo(f"picture  {out}")
    raise typer.Exit(questions.exit_status(answers))


@commands.command(rich_help_panel=FIELDS)
@with_options("threshold", "canonical", "temperature", "absent", *PLACES, common=COMMON["segment"])
def segment(
    settings: dict,
    field: Folder,
    texts: Texts,
    view: Views = None,
    between: Between = None,
    camera: CameraFile = None,
    orbit: Orbit = None,
    words: Words = None,
    out: Picture = None,
    as_json: AsJson = False,
) -> None:
    """Give each object in view the text that fits it best.

    What fits no text better than canonical phrases ("object", "things" ...) gets none; --threshold
    moves that bound from 0.5. Prints a row a text: its label, its share of the pixels, how well it
    fits them on average, what a query for it alone says, and its objects. The exit status is 1 if a
    text is refused.

    -o labels.png draws it with a legend, and writes labels.ids.png beside it: a grey PNG with 16
    bits, whose pixels are labels, 1 for the first text and 0 for none.

    \b
    slgaussian segment field/ wall floor "red sofa" -o labels.png
    slgaussian segment field/ wall floor "red sofa" --between 0 1 0.5 --json
    slgaussian segment field/ wall floor "red sofa" --orbit 60 -o turn.mp4
    """
    import json

    from flows.cli import questions
    from flows.cli.viewpoints import Choice

    choice = Choice(view or (), camera, between, orbit)
    rows = questions.segmented(field, texts, choice, out, settings, words)
    typer.echo("\n".join(map(json.dumps, rows)) if as_json else questions.tabled(rows))
    if out is not None and not as_json:
        typer.echo(f"picture  {out}")
        if not choice.film:
            typer.echo(f"labels   {out.with_suffix('.ids.png')}")
    if any(row.get("refused") for row in rows):
        raise typer.Exit(1)


@commands.command(rich_help_panel=FIELDS)
def words() -> None:
    """List the words that the encoder lexicon knows.

    By family, with synonyms in brackets.

    \b
    slgaussian words
    """
    from slgaussian.language.vocabulary import load_vocabulary

    for family, spellings in load_vocabulary().families().items():
        listed = (f"{name} ({', '.join(o)})" if o else name for name, o in spellings.items())
        typer.echo(f"{family}: {', '.join(listed)}")


@commands.command(rich_help_panel=FIELDS)
@with_options("temperature", "canonical", "absent", *PLACES, common=COMMON["objects"])
def objects(
    settings: dict,
    field: Folder,
    texts: Annotated[
        list[str] | None,
        typer.Argument(metavar="TEXT", help="What to tell objects by. [default: what is known]"),
    ] = None,
    words: Words = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Table (.parquet), or picture of all (.png).")
    ] = None,
    crops: Annotated[
        Path | None, typer.Option(metavar="<path>", help="Folder for a picture of each: ID.png.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the objects of a field: words, size, place and views.

    Each has the words that fit it best, of all that the field knows or of the texts given; how
    clearly its pixels are its own (from 0 to 1); the size of the upright box around it, longer
    side, shorter side and height; and the views that hold it. The table and --json have its centre
    and axes too. The exit status is 1 if a text is refused.

    \b
    slgaussian objects field/
    slgaussian objects field/ wall "red sofa" plant -o objects.png
    slgaussian objects field/ -o objects.parquet --crops things/
    """
    import json

    from flows.cli import things

    rows = things.inventory(field, texts or [], out, crops, settings, words)
    typer.echo("\n".join(map(json.dumps, rows)) if as_json else things.listed(rows))
    if any(row.get("refused") for row in rows):
        raise typer.Exit(1)


@commands.command(rich_help_panel=FIELDS)
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
    slgaussian teach field/ fox --at 312 140
    slgaussian teach field/ fox --at 80 210 --view 1
    slgaussian query field/ fox -o hit.png
    slgaussian teach field/ fox --forget
    """
    from flows.cli import things

    if forget == (at is not None):
        raise InputError("say either where it is, with --at X Y, or --forget")
    if forget:
        things.forget(field, word)
        typer.echo(f"{word!r} is forgotten")
        return
    assert at is not None
    lesson = things.teach(field, word, at, view)
    typer.echo(f"{word!r} is object {lesson['object']}")
    typer.echo(f"examples  {lesson['examples']}")
    typer.echo(f"it means  {things.told(lesson['found'])}")


@commands.command(rich_help_panel=FIELDS)
def render(
    source: Annotated[
        Path,
        typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture: .png or .jpg.")],
    view: Views = None,
    between: Between = None,
    camera: CameraFile = None,
    orbit: Orbit = None,
    stats: Annotated[
        bool, typer.Option("--stats", help="Print what the field is made of, and the time taken.")
    ] = False,
) -> None:
    """Draw a field, or any .ply of Gaussians, from a camera.

    Draws colour and depth, and of a field its objects. A field knows its own cameras; a .ply knows
    none, so give some in its world with --camera. No GPU and no photograph is needed.

    \b
    slgaussian render field/ -o picture.png --view 1
    slgaussian render field/ -o middle.png --between 0 1 0.5
    slgaussian render field/ -o turn.mp4 --orbit 60
    slgaussian render scene.ply --camera transforms.json -o picture.png
    """
    from flows.cli.fields import picture
    from flows.cli.viewpoints import Choice

    picture(source, Choice(view or (), camera, between, orbit), out, stats)
    typer.echo(out)


@commands.command(rich_help_panel=FIELDS)
@with_options(*PLACES, common=COMMON["view"])
def view(
    settings: dict,
    source: Annotated[
        Path,
        typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply."),
    ],
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="Where to listen. [default: 8080, or a free one]"),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Who can open it: at 0.0.0.0, whoever has the address it prints.")
    ] = "127.0.0.1",
) -> None:
    """Look at a scene in the browser; ask it by word and by click.

    Prints the address to open. Several people may open it, and change the same field.
    Type a word, or click a thing to see what it is, to name it, to teach a word for it, or to
    remove it; Save changes writes all that into the folder of the field. A .ply can only be looked
    at. Ctrl-C ends it.

    \b
    slgaussian view field/
    slgaussian view field/ --port 9000
    slgaussian view scene.ply
    """
    from flows.cli.viewing import view as look

    look(source, host, port, settings)


@commands.command(rich_help_panel=FIELDS)
@with_options(*PLACES, common=COMMON["export"])
def export(
    settings: dict,
    source: Annotated[
        Path,
        typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="File: .html, .ply or .spz.")],
    what: Annotated[
        str | None,
        typer.Option("--object", help="Write this alone: a text, a name you gave, or an id."),
    ] = None,
    texts: Annotated[
        list[str] | None,
        typer.Option("--text", help="What a page shall answer, beside its words; may be repeated."),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Title of a page.")] = None,
) -> None:
    """Write a field as one file: a page to send, or for a viewer.

    A page (.html) opens from disk in any browser, without a network: look around, ask words, click
    things. It holds small copies of the photographs. A .ply keeps everything: each Gaussian also
    carries its ID code and weight (f_sem_0 and on; without codes the number of its object), the
    pixel that it came from (source), and its object (label, 0 for none). A .spz keeps
    Gaussians in fewer bytes.

    \b
    slgaussian export field/ -o scene.html
    slgaussian export field/ -o scene.spz
    slgaussian export field/ --object "red chair" -o chair.ply
    """
    from flows.cli.exporting import export as write

    write(source, out, what, texts or [], title, settings)
    typer.echo(out)


@commands.command(rich_help_panel=FIELDS)
@with_options(*RULES, *PLACES, common=COMMON["extract"])
def extract(
    settings: dict,
    field: Folder,
    what: What,
    out: Annotated[Path, typer.Option("--out", "-o", help=".ply file, or folder for a field.")],
    words: Words = None,
) -> None:
    """Take a thing out of a field, alone.

    A text takes the objects that a query would take, in whatever view. The exit status is 3 if the
    scene as a whole does not hold it, by the verdict of `query`; then nothing is written.

    \b
    slgaussian extract field/ "red chair" -o chair.ply
    slgaussian extract field/ 17 -o chair/
    """
    from flows.cli import things

    made = things.take_out(field, what, out, settings, words)
    if not made["found"]:
        typer.echo(f"nothing found for {what!r}, so nothing is written")
        raise typer.Exit(3)
    typer.echo(f"objects  {things.told(made['found'])}")
    typer.echo(f"{made['gaussians']:,} Gaussians  {out}")


@commands.command(rich_help_panel=FIELDS)
@with_options(*RULES, *PLACES, common=COMMON["remove"])
def remove(
    settings: dict,
    field: Folder,
    what: Annotated[
        list[str],
        typer.Argument(metavar="WHAT", help="Texts, names that you gave, or ids of objects."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field without it.")],
    words: Words = None,
) -> None:
    """Write a field again without some of its things.

    What was behind is shown where another view saw it. Where none did, nothing is painted: pictures
    have grey stripes there. The exit status is 3 if nothing is found for any text; what is found of
    the others is removed.

    \b
    slgaussian remove field/ "red chair" -o without/
    slgaussian render without/ -o picture.png
    """
    from flows.cli import things

    *rows, last = things.remove(field, what, out, settings, words)
    rows = rows if "open" in last else [*rows, last]
    for row in rows:
        found = f"objects {things.told(row['found'])}" if row["found"] else "nothing found"
        typer.echo(f"{row['text']!r}: {found}, {row['gaussians']:,} Gaussians")
    if "open" in last:
        typer.echo(f"open in the context views: {100 * last['open']:.1f} % of the pixels")
        typer.echo(out)
    if not all(row["found"] for row in rows):
        raise typer.Exit(3)
