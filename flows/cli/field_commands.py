"""The commands about one field. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.cli.object_commands import objects
from flows.cli.options import settings_from
from slgaussian.errors import InputError

commands = typer.Typer()
commands.add_typer(objects, name="objects", rich_help_panel=options.FIELDS)

Photos = Annotated[
    list[str], typer.Argument(metavar="PHOTO", help="Two or more photographs, or a folder of them.")
]
Cameras = Annotated[
    Path | None,
    typer.Option(
        help="Their cameras: transforms.json, poses_bounds.npy, or a COLMAP folder; found if left "
        "out."
    ),
]
Refine = Annotated[
    bool, typer.Option("--refine", help="Find given cameras anew, in their own world.")
]
Folder = Annotated[
    Path, typer.Argument(metavar="FIELD", help="Folder that `field` wrote, or OUT/fields/SCENE.")
]
FieldOrPly = Annotated[
    Path, typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply.")
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
        help="Look from other cameras: one as JSON, or a transforms.json.",
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
    Path | None, typer.Option("--out", "-o", help="Picture of the answer: .png or .jpg.")
]


@commands.command(rich_help_panel=options.FIELDS)
def demo(
    ctx: typer.Context,
    out: options.Out = Path("slg-demo"),
    preset: options.Preset = None,
    encoder: options.Encoder = None,
    seed: options.Seed = None,
    store: options.Store = None,
    runner: options.Runner = None,
    workers: options.Workers = None,
    set_: options.Set = None,
    verbose: options.Verbose = False,
) -> None:
    """Try everything on scenes that come with the installation.

    A stereo pair with true depth, and three made-up rooms in which everything is known. It takes
    one or two minutes, leaves a report and a field of every scene, and ends with a command that
    asks one. Run it again, and what is unchanged comes from the store.

    \b
    slgaussian demo
    slgaussian query slg-demo/fields/room_0 "purple ball" -o hit.png
    slgaussian demo --preset fast --store /data/slg -o fast
    """
    from flows.cli.run import run_scenes
    from flows.demo import demo_scenes
    from flows.settings import make_settings

    values = settings_from(ctx, out=out, scenes=demo_scenes())
    run_scenes("demo", make_settings(values, "demo"), verbose)


@commands.command(rich_help_panel=options.FIELDS)
def field(
    ctx: typer.Context,
    photos: Photos,
    cameras: Cameras = None,
    refine: Refine = False,
    keyframes: Annotated[
        int | None,
        typer.Option(metavar="N", min=2, help="Of a walk, use the N sharpest, evenly."),
    ] = None,
    preset: options.Preset = None,
    size: options.Size = None,
    predictor: options.Predictor = None,
    proposer: options.Proposer = None,
    tracker: options.Tracker = None,
    encoder: options.Encoder = None,
    set_: options.Set = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field.")] = Path("field"),
) -> None:
    """Build a field from two or more photographs.

    A field is a folder with the scene as Gaussians and what words need to find its objects.
    `query`, `segment`, `render` and `export` open it. Cameras that are found are in no metres: the
    first two are 1 apart.

    \b
    slgaussian field a.jpg b.jpg -o field/
    slgaussian field walk/*.jpg --cameras sparse/0 --keyframes 24 -o field/
    slgaussian field a.jpg b.jpg --encoder clip --set clip.model=models/clip -o field/
    """
    from flows.cli.field import build

    settings = settings_from(ctx)
    build(photos, cameras, refine, keyframes, out, settings)
    typer.echo(out)


@commands.command(rich_help_panel=options.FIELDS)
def cameras(
    photos: Photos,
    out: Annotated[
        str | None,
        typer.Option(
            "--out", "-o", help="transforms.json, or a folder ending in / for a COLMAP model."
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Find the cameras of photographs.

    Prints a row for each pair: matches, those that its pose explains, degrees between the lines of
    sight, by how many degrees the pose may be off, and a verdict. The world is the first camera's;
    the first two are 1 apart. A transforms.json says all this too, and `--cameras` reads it.

    \b
    slgaussian cameras a.jpg b.jpg
    slgaussian cameras photos/ -o transforms.json
    slgaussian cameras photos/ -o model/
    slgaussian field photos/a.jpg photos/b.jpg --cameras transforms.json -o field/
    """
    import json

    from flows.cli.cameras import estimate_cameras, pairs_table

    estimate = estimate_cameras(photos, out)
    typer.echo(json.dumps(estimate.as_json()) if as_json else pairs_table(estimate))
    if out is not None and not as_json:
        typer.echo(out)


@commands.command(rich_help_panel=options.FIELDS)
def masks(
    ctx: typer.Context,
    photos: Photos,
    cameras: Cameras = None,
    refine: Refine = False,
    preset: options.Preset = None,
    size: options.Size = None,
    predictor: options.Predictor = None,
    proposer: options.Proposer = None,
    tracker: options.Tracker = None,
    set_: options.Set = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the maps.")] = Path("ids"),
) -> None:
    """Label the objects of photographs, alike in all views.

    Writes a map of each view, a grey PNG with 16 bits whose pixels are ids, 0 for none; and
    look.jpg, to look at. The tracker precomputed reads the maps: change them, and build a field.

    \b
    slgaussian masks a.jpg b.jpg -o ids/
    slgaussian masks a.jpg b.jpg --cameras transforms.json --proposer sam -o ids/
    slgaussian field a.jpg b.jpg --tracker precomputed --set precomputed.folder=ids/ -o field/
    """
    from flows.cli.masks import label, maps_table

    settings = settings_from(ctx)
    typer.echo(maps_table(*label(photos, cameras, refine, out, settings)))
    typer.echo(out)


@commands.command(rich_help_panel=options.FIELDS)
def query(
    ctx: typer.Context,
    field: Folder,
    texts: Annotated[
        list[str] | None,
        typer.Argument(metavar="TEXT", help='What to look for, as "red basket".'),
    ] = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(metavar="<path>", help="Look for what a picture shows; may be repeated."),
    ] = None,
    view: Views = None,
    between: Between = None,
    camera: CameraFile = None,
    orbit: Orbit = None,
    preset: options.Preset = None,
    threshold: options.Threshold = None,
    words: Words = None,
    set_: options.Set = None,
    out: Picture = None,
    as_json: options.AsJson = False,
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
    slgaussian query field/ --like crop.png --set share=0.8 -o hit.png
    """
    import json

    from flows.cli.query import answers_text, ask, exit_status
    from flows.cli.viewpoints import Choice

    if not texts and not like:
        raise InputError("nothing is asked: give a TEXT, or a picture with --like")
    choice = Choice(view or (), camera, between, orbit)
    settings = settings_from(ctx)
    answers = ask(field, texts or [], choice, out, settings, words, like or ())
    if as_json:
        typer.echo("\n".join(map(json.dumps, answers)))
    else:
        typer.echo(answers_text(answers, choice.film))
        if out is not None:
            typer.echo(f"picture  {out}")
    raise typer.Exit(exit_status(answers))


@commands.command(rich_help_panel=options.FIELDS)
def segment(
    ctx: typer.Context,
    field: Folder,
    texts: Annotated[
        list[str], typer.Argument(metavar="TEXT", help='What to look for, as "red basket".')
    ],
    view: Views = None,
    between: Between = None,
    camera: CameraFile = None,
    orbit: Orbit = None,
    threshold: options.Threshold = None,
    words: Words = None,
    set_: options.Set = None,
    out: Picture = None,
    as_json: options.AsJson = False,
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

    from flows.cli.query import segment_views, texts_table
    from flows.cli.viewpoints import Choice

    choice = Choice(view or (), camera, between, orbit)
    settings = settings_from(ctx)
    rows = segment_views(field, texts, choice, out, settings, words)
    typer.echo("\n".join(map(json.dumps, rows)) if as_json else texts_table(rows))
    if out is not None and not as_json:
        typer.echo(f"picture  {out}")
        if not choice.film:
            typer.echo(f"labels   {out.with_suffix('.ids.png')}")
    if any(row.get("refused") for row in rows):
        raise typer.Exit(1)


@commands.command(rich_help_panel=options.FIELDS)
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


@commands.command(rich_help_panel=options.FIELDS)
def render(
    source: FieldOrPly,
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
    from flows.cli.render import draw
    from flows.cli.viewpoints import Choice

    draw(source, Choice(view or (), camera, between, orbit), out, stats)
    typer.echo(out)


@commands.command(rich_help_panel=options.FIELDS)
def view(
    ctx: typer.Context,
    source: FieldOrPly,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="Where to listen. [default: 8080, or a free one]"),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Who can open it: at 0.0.0.0, whoever has the address it prints.")
    ] = "127.0.0.1",
    set_: options.Set = None,
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
    from flows.cli.view import serve_page

    serve_page(source, host, port, settings_from(ctx))


@commands.command(rich_help_panel=options.FIELDS)
def export(
    ctx: typer.Context,
    source: FieldOrPly,
    out: Annotated[Path, typer.Option("--out", "-o", help="File: .html, .ply or .spz.")],
    name: Annotated[
        str | None,
        typer.Option("--object", help="Write this alone: a text, a name you gave, or an id."),
    ] = None,
    texts: Annotated[
        list[str] | None,
        typer.Option("--text", help="What a page shall answer, beside its words; may be repeated."),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Title of a page.")] = None,
    set_: options.Set = None,
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
    from flows.cli.export import write

    write(source, out, name, texts or [], title, settings_from(ctx))
    typer.echo(out)
