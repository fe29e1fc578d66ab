"""The command line. Heavy imports wait until a command needs them: `--help` answers at once."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from flows.cli.help import App, told
from flows.cli.options import with_options
from flows.cli.store_commands import store_app
from flows.corpus_settings import CorpusSettings, IndexSettings, PackSettings
from flows.runners.display import Waiting
from flows.settings import files_of, tables_of
from flows.training_settings import RetrainSettings, TrainSettings
from slgaussian import __version__
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.kernels import compiling
from slgaussian.parts.registry import KINDS

RULES = ("protocol", "threshold", "share", "temperature", "canonical", "absent")
METHOD = (
    "size", "near", "far", "trust_cameras", *KINDS, "replicas", *RULES, "seed", "keep", "bank",
    *tables_of(),
)  # fmt: skip
PLACES = files_of("encoder")
FILES = (*(kind for kind in KINDS if files_of(kind)), *files_of(*KINDS))
BUILD = ("preset", *(name for name in METHOD if name not in RULES))
RUN = ("preset", *METHOD, "store", "runner", "workers", "method")
INGEST = (
    "min_overlap", "max_overlap", "min_baseline", "max_baseline", "max_blur", "max_clipped",
    "most", "store", "runner", "workers",
)  # fmt: skip
LABEL = ("predictor", "proposer", "tracker")
SUPERVISE = ("size", "near", "far", *LABEL, "replicas", "seed", *tables_of(*LABEL), *INGEST)
MASKS = (
    "preset", "size", "near", "far", "trust_cameras", *LABEL, "replicas", "seed",
    *tables_of(*LABEL),
)  # fmt: skip
TRAIN = ("steps", "rate", "corrupted", "held_out", "codes", "seed")

PARTS = (*LABEL, "encoder")
ENGINE = ("store", "runner", "workers")
COMMON = {
    "demo": ("preset", "size", *PARTS, "seed", *ENGINE),
    "benchmark": (
        "data",
        "pairs",
        "labels",
        "rooms",
        "views",
        "preset",
        "encoder",
        "seed",
        *ENGINE,
    ),
    "run": ("preset", "seed", *ENGINE),
    "pairs": ("format", "min_overlap", "max_overlap", "min_baseline", "max_baseline"),
    "field": ("preset", "size", *PARTS),
    "masks": ("preset", "size", *PARTS[:3], "replicas"),
    "query": ("threshold",),
    "segment": ("threshold",),
    "objects": (),
    "export": (),
    "view": (),
    "extract": ("threshold",),
    "remove": ("threshold",),
    "ingest": ("min_overlap", "max_overlap", "most", *ENGINE),
    "supervise": ("size", *PARTS[:3], "most", *ENGINE),
    "train": ("steps", "rate", "codes", "seed", "store"),
    "retrain": ("chunks", "out", "models", "steps", *PARTS[:2], "seed", "store"),
    "doctor": ("store", "runner", *PARTS, "lifting"),
}
"""The settings that most people need of a command: `--help` shows these, `--help-all` the rest."""

FIELDS, SCORES = "Build a field and ask it", "Score it"
CORPORA, UPKEEP = "Learn from many scenes", "Look after an installation"
"""The headings of the commands."""

app = App(
    help="Two photographs in, a scene that answers words out. Try `slgaussian demo`.",
)
app.add_typer(store_app, name="store", rich_help_panel=UPKEEP)

Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for every stage.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]
Folder = Annotated[
    Path, typer.Argument(metavar="FIELD", help="Folder that `field` wrote, or OUT/fields/SCENE.")
]
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
    bool,
    typer.Option("--refine", help="Find given cameras anew, in their own world."),
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

Chunks = Annotated[
    str, typer.Argument(metavar="CHUNKS", help="Folder or fsspec URL of .torch chunks.")
]


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"slgaussian {__version__}")
        raise typer.Exit


@app.callback()
def slgaussian(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_say_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """What all commands have."""


@app.command(rich_help_panel=FIELDS)
@with_options(*RUN, common=COMMON["demo"])
def demo(settings: dict, out: Out = Path("slg-demo"), verbose: Verbose = False) -> None:
    """Try everything on scenes that come with the installation.

    A stereo pair with true depth, and three made-up rooms in which everything is known. It takes a
    few minutes, leaves a report and a field of every scene, and ends with a command that asks one.
    Run it again, and what is unchanged comes from the store.

    \b
    slgaussian demo
    slgaussian query slg-demo/fields/room_0 "purple ball" -o hit.png
    slgaussian demo --preset fast --store /data/slg -o fast
    """
    from flows.demo import demo_scenes
    from flows.settings import make_settings

    given = {**settings, "out": out, "scenes": demo_scenes()}
    _run("demo", make_settings(given, "demo"), verbose)


def _baselines() -> list[str]:
    """The baselines whose names a shell takes as one word."""
    from slgaussian.benchmark.baselines import ROWS

    return [name for name in ("all", *ROWS) if " " not in name]


@app.command(rich_help_panel=SCORES)
@with_options(
    "data", "pairs", "labels", "format", "rooms", "views", *RUN, common=COMMON["benchmark"]
)
def benchmark(
    settings: dict,
    against: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<name>",
            autocompletion=_baselines,
            help="Another method to score as well, by name, or all but slow ones; may be repeated.",
        ),
    ] = None,
    out: Out = Path("slg-benchmark"),
    verbose: Verbose = False,
) -> None:
    """Score the method, and others, on a labelled set.

    Builds a field from each scene's context views and asks it in its target views. Leaves a report,
    tables, masks, fields, and failures.parquet. Of an index of RealEstate10K, it scores the clips
    that are there.

    \b
    slgaussian benchmark --rooms 0-19 --against query-2d --against lerf-like
    slgaussian benchmark --data re10k/test --pairs evaluation_index_re10k.json
    slgaussian benchmark --rooms 0-19 --views 2,4,8 -o numbers
    slgaussian benchmark --data office --pairs office/pairs.json \\
        --labels office/labels -o scores
    """
    from flows.settings import make_settings

    given = {**settings, "against": against or [], "out": out}
    _run("benchmark", make_settings(given, "benchmark"), verbose)


def _protocols() -> list[str]:
    """The protocols by which masks are scored."""
    from slgaussian.benchmark.given import GIVEN

    return list(GIVEN)


@app.command(rich_help_panel=SCORES)
@with_options("data", "pairs", "labels", "format", "rooms", "size")
def score(
    settings: dict,
    predictions: Annotated[
        Path,
        typer.Argument(
            metavar="PREDICTIONS", help="Folder of masks as `benchmark` writes it, or a JSON file."
        ),
    ],
    protocol: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<name>",
            autocompletion=_protocols,
            help="What scores mean: slgaussian, langsplat, langsplat-rescaled or 3d-ovs; may be "
            "repeated. [default: all that the folder has]",
        ),
    ] = None,
    out: Out = Path("slg-score"),
) -> None:
    """Score masks that you made, as `benchmark` scores its own.

    Masks are PNG files, METHOD/PROTOCOL/SCENE/FRAME/QUERY.png, or a JSON file of COCO's run
    lengths. One that is missing counts as empty. Without --pairs every labelled frame is asked what
    is labelled in it. Leaves tables and masks as `benchmark` does, which `compare` reads.

    \b
    slgaussian score masks --data office --pairs office/pairs.json \\
        --labels office/labels -o mine
    slgaussian score masks.json --rooms 0-19 --size 416x576 --protocol 3d-ovs
    slgaussian compare scores mine
    """
    from flows.settings import make_settings

    chosen = make_settings({**settings, "out": out}, "score")
    from flows.cli.scoring import score as scored

    table, said = scored(chosen, predictions, protocol or [], out)
    for text in said:
        typer.echo(text, err=True)
    typer.echo(table)
    typer.echo(out)


@app.command(rich_help_panel=SCORES)
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Folder that a run wrote.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for compare.html and compare.md.")
    ] = None,
) -> None:
    """Compare the settings and the scores of two reports.

    Differences are B minus A, for each method, on the queries that both were asked, with bootstrap
    intervals over scenes.

    \b
    slgaussian benchmark --rooms 0-9 -o before
    slgaussian benchmark --rooms 0-9 --replicas 1 -o after
    slgaussian compare before after -o changes
    """
    from flows.cli.comparing import compare as compared

    typer.echo(compared(first, second, out))


@app.command(rich_help_panel=SCORES)
def leaderboard(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULTS", help="Folders that benchmark, score or run wrote."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for leaderboard.html and leaderboard.md."),
    ] = None,
) -> None:
    """Rank the methods of several runs: a leaderboard.

    They may be of any machine, version or author. There is a table for each data set, protocol and
    judging size: scores with intervals, seconds, memory, machine and version. Only methods that
    were asked the same are ranked together; what was asked something else stands apart and says how
    it differs. Other data and settings are named.

    \b
    slgaussian benchmark --rooms 0-9 --against all -o ours
    slgaussian score masks --rooms 0-9 --size 416x576 -o theirs
    slgaussian leaderboard ours theirs -o board
    """
    from flows.cli.leading import leaderboard as ranked

    typer.echo(ranked(results, out))


@app.command(rich_help_panel=SCORES)
@with_options(*IndexSettings.model_fields, of=IndexSettings, common=COMMON["pairs"])
def pairs(
    settings: dict,
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder of the data, as its format has it.")
    ],
    labels: Annotated[
        Path | None,
        typer.Option(help="Folder of labels, if the format has none of its own, or other ones."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="JSON file.")] = Path("pairs.json"),
) -> None:
    """Choose context views for the labelled frames of a set.

    Writes an index that `benchmark` reads: two context views for each labelled frame. They are
    never labelled themselves; they are sharp, overlap, and see nearly all of the labelled frame,
    which lies between them. The best such pair is taken. The file also holds the rule, what was
    measured, and the frames without a pair, so that anybody can score the same pairs.

    \b
    slgaussian pairs lerf_ovs --format lerf_ovs -o pairs.json
    slgaussian pairs 3dovs --format ovs3d -o pairs.json --max-baseline 0.6
    slgaussian pairs walk --labels walk/labels -o walk/pairs.json
    """
    from flows.corpus_settings import check_bounds
    from flows.settings import checked

    chosen = checked(IndexSettings, settings, "pairs")
    check_bounds(chosen, "pairs")
    from flows.indexing import build_index

    index = build_index(data, labels, chosen, out)
    for name, reason in index.left_out.items():
        typer.echo(f"left out: {name}: {reason}", err=True)
    typer.echo(f"{len(index.pairs)} pairs  {out}")


@app.command(rich_help_panel=SCORES)
@with_options(*RUN, common=COMMON["run"])
def run(
    settings: dict,
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results.")] = None,
    verbose: Verbose = False,
) -> None:
    """Run a configuration file, and write its report and fields.

    Options given here win over the file. Paths in the file are relative to the file.

    \b
    out = "results"
    replicas = 5
    [[scenes]]
    name = "kitchen"
    path = "kitchen/transforms.json"
    context = ["0001.png", "0009.png"]
    targets = ["0005.png"]
    queries = ["red kettle", "wooden table"]

    \b
    slgaussian run kitchen.toml
    slgaussian run kitchen.toml --preset fast -o fast
    """
    from flows.settings import read_toml

    given = settings if out is None else {**settings, "out": out}
    _run("run", read_toml(config, given), verbose)


@app.command(rich_help_panel=FIELDS)
@with_options(*BUILD, common=COMMON["field"])
def field(
    settings: dict,
    photos: Photos,
    cameras: Cameras = None,
    refine: Refine = False,
    keyframes: Annotated[
        int | None,
        typer.Option(metavar="N", min=2, help="Of a walk, use the N sharpest, evenly."),
    ] = None,
    add: Annotated[
        bool, typer.Option("--add", help="Add photographs to the field that is named last.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the field. [default: field]")
    ] = None,
) -> None:
    """Build a field from two or more photographs, or add some to it.

    A field is a folder with the scene as Gaussians and what words need to find its objects.
    `query`, `segment`, `render` and `export` open it. Cameras that are found are in no metres: the
    first two are 1 apart.

    \b
    slgaussian field a.jpg b.jpg -o field/
    slgaussian field --add c.jpg field/
    slgaussian field walk/*.jpg --cameras sparse/0 --keyframes 24 -o field/
    """
    if add:
        given = "--refine" if refine else "--keyframes" if keyframes is not None else None
        if given:
            raise InputError(f"{given}: is for a new field, and not for --add; leave one out")
        from flows.cli.adding import add as added

        typer.echo(added(photos, cameras, out, settings))
        return
    from flows.cli.fields import build

    typer.echo(build(photos, cameras, refine, keyframes, out or Path("field"), settings))


@app.command(rich_help_panel=FIELDS)
def cameras(
    photos: Photos,
    out: Annotated[
        str | None,
        typer.Option(
            "--out", "-o", help="transforms.json, or a folder ending in / for a COLMAP model."
        ),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(metavar="<name>", help="How to write them: nerfstudio or colmap."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
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

    from flows.cli import finding

    found = finding.keep(photos, out, format)
    finding.tell(found)
    typer.echo(json.dumps(found.as_json()) if as_json else finding.tabled(found))
    if out is not None and not as_json:
        typer.echo(out)


@app.command(rich_help_panel=FIELDS)
@with_options(*MASKS, common=COMMON["masks"])
def masks(
    settings: dict,
    photos: Photos,
    cameras: Cameras = None,
    refine: Refine = False,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the maps.")] = Path("ids"),
) -> None:
    """Label the objects of photographs, alike in all views.

    Writes a map of each view, a grey PNG with 16 bits whose pixels are ids, 0 for none; and
    look.jpg, to look at. The tracker precomputed reads the maps: change them, and build a field.

    \b
    slgaussian masks a.jpg b.jpg -o ids/
    slgaussian masks a.jpg b.jpg --cameras transforms.json --proposer sam -o ids/
    slgaussian field a.jpg b.jpg --tracker precomputed \\
        --precomputed-folder ids/ -o field/
    """
    from flows.cli.labelling import label, tabled

    typer.echo(tabled(label(photos, cameras, refine, out, settings)))
    typer.echo(out)


@app.command(rich_help_panel=FIELDS)
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
    Says how likely that is right. The exit status is 1 if nothing is found for any text, or a text
    is refused.

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
    nothing = not any(answer["found"] for answer in answers)
    if nothing or any(answer["refused"] for answer in answers):
        raise typer.Exit(1)


@app.command(rich_help_panel=FIELDS)
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
    fits them on average, and its objects. The exit status is 1 if a text is refused.

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


@app.command(rich_help_panel=FIELDS)
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


@app.command(rich_help_panel=FIELDS)
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


@app.command(rich_help_panel=FIELDS)
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

    Prints the address to open. Several people may open it: what one asks and changes, all see.
    Type a word, or click a thing to see what it is, to teach a word for it, or to remove it; Save
    writes changes into the folder of the field. A .ply can only be looked at. Ctrl-C ends it.
    Needs viser, the extra `view`.

    \b
    slgaussian view field/
    slgaussian view field/ --port 9000
    slgaussian view scene.ply
    """
    from flows.cli.viewing import view as look

    look(source, host, port, settings)


@app.command(rich_help_panel=FIELDS)
@with_options(*PLACES, common=COMMON["export"])
def export(
    settings: dict,
    source: Annotated[
        Path,
        typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply."),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File: .html, .ply, .splat, .spz or .glb.")
    ],
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
    pixel that it came from (source), and its object (label, 0 for none). A .splat and .spz keep
    Gaussians in fewer bytes, a .glb their centres as points.

    \b
    slgaussian export field/ -o scene.html
    slgaussian export field/ -o scene.spz
    slgaussian export field/ --object "red chair" -o chair.glb
    """
    from flows.cli.exporting import export as write

    write(source, out, what, texts or [], title, settings)
    typer.echo(out)


@app.command(rich_help_panel=FIELDS)
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


@app.command(rich_help_panel=FIELDS)
@with_options(*RULES, *PLACES, common=COMMON["extract"])
def extract(
    settings: dict,
    field: Folder,
    what: What,
    out: Annotated[Path, typer.Option("--out", "-o", help=".ply file, or folder for a field.")],
    words: Words = None,
) -> None:
    """Take a thing out of a field, alone.

    A text takes the objects that a query would take, in whatever view. The exit status is 1 if
    nothing is found; then nothing is written.

    \b
    slgaussian extract field/ "red chair" -o chair.ply
    slgaussian extract field/ 17 -o chair/
    """
    from flows.cli import things

    made = things.take_out(field, what, out, settings, words)
    if not made["found"]:
        typer.echo(f"nothing found for {what!r}, so nothing is written")
        raise typer.Exit(1)
    typer.echo(f"objects  {things.told(made['found'])}")
    typer.echo(f"{made['gaussians']:,} Gaussians  {out}")


@app.command(rich_help_panel=FIELDS)
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
    have grey stripes there. The exit status is 1 if nothing is found for any text; what is found of
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
        raise typer.Exit(1)


@app.command(rich_help_panel=FIELDS)
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
    counter: Annotated[
        bool, typer.Option("--not", help="The thing is not what the word means.")
    ] = False,
    forget: Annotated[bool, typer.Option("--forget", help="Forget the word.")] = False,
) -> None:
    """Teach a field a word of your own by pointing at a thing.

    The word is kept in the field, and asked like any other. Point again, at other things or in
    other views, for more examples; with --not at what is taken by mistake. Other fields of the same
    place take the words with --words field/words.npz.

    \b
    slgaussian teach field/ fox --at 312 140
    slgaussian teach field/ fox --at 80 210 --view 1 --not
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
    said = things.teach(field, word, at, view, counter)
    yes, no = said["examples"]
    typer.echo(f"{word!r} is {'not ' if counter else ''}object {said['object']}")
    typer.echo(f"examples  {yes}, counter-examples  {no}")
    typer.echo(f"it means  {things.told(said['found']) or 'nothing yet'}")


@app.command(rich_help_panel=CORPORA)
@with_options(*PackSettings.model_fields, of=PackSettings)
def pack(
    settings: dict,
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Folder of photographs, or procedural:FIRST-LAST (seeds of rooms).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the chunks.")],
) -> None:
    """Write scenes as chunks, the format of RealEstate10K.

    Each scene becomes one clip with the name of its folder. New clips are added to chunks that are
    there; a clip that is there already is refused.

    \b
    slgaussian pack procedural:0-39 office_walk -o chunks/train
    slgaussian pack procedural:40-59 -o chunks/train --views 24 --baseline 1.6
    """
    from flows.packing import pack as write
    from flows.settings import checked

    packed = write(sources, out, checked(PackSettings, settings, "pack"))
    typer.echo(f"{packed.clips} clips in {len(packed.chunks)} chunks  {out}")
    if packed.left_out:
        typer.echo(f"left out: {len(packed.left_out)}, each said above", err=True)
        raise typer.Exit(1)


@app.command(rich_help_panel=CORPORA)
@with_options(*INGEST, of=CorpusSettings, common=COMMON["ingest"])
def ingest(settings: dict, chunks: Chunks, out: Out, verbose: Verbose = False) -> None:
    """Choose samples to learn from in a corpus of chunks.

    Looks at every view. Leaves views.parquet (camera, blur, exposure and distance of each view),
    pairs.parquet (two context and three target views each) and failures.parquet (what could not
    be used, and why). After new chunks were added, only those are read.

    \b
    slgaussian ingest chunks/train -o corpus
    slgaussian ingest s3://bucket/re10k/train -o corpus --most 2
    """
    _prepare("ingest", {**settings, "chunks": chunks, "out": out}, verbose)


@app.command(rich_help_panel=CORPORA)
@with_options(*SUPERVISE, of=CorpusSettings, common=COMMON["supervise"])
def supervise(settings: dict, chunks: Chunks, out: Out, verbose: Verbose = False) -> None:
    """Label the samples of a corpus: lessons for `train`.

    Predicts Gaussians and object masks for all views. Leaves what `ingest` leaves, lessons.parquet,
    and under sheets/ pictures of the labels: look at some. Other masks do not predict Gaussians
    again.

    \b
    slgaussian supervise chunks/train -o corpus
    slgaussian supervise chunks/train -o corpus \\
        --proposer sam --sam-model facebook/sam-vit-base
    """
    _prepare("supervise", {**settings, "chunks": chunks, "out": out}, verbose)


@app.command(rich_help_panel=CORPORA)
@with_options(*TRAIN, "store", of=TrainSettings, common=COMMON["train"])
def train(
    settings: dict,
    lessons: Annotated[Path, typer.Option(help="Folder that `supervise` wrote.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for weights and report.")],
    start: Annotated[
        Path | None,
        typer.Option("--from", help="Weights to begin from: a file, or a folder of versions."),
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Train the semantic branch on lessons, and judge it.

    It is judged on clips that it has not seen. Leaves branch.safetensors, report.html,
    metrics.parquet (a row a step) and judgements.parquet (a row a held-out lesson and lifting).
    A training that was interrupted goes on where it was.

    \b
    slgaussian train --lessons corpus -o trained
    slgaussian train --lessons corpus --from trained/branch.safetensors -o more
    slgaussian field a.png b.png --cameras transforms.json --lifting branch \\
        --branch-weights trained/branch.safetensors -o field/
    """
    from flows.settings import checked

    given = {"lessons": lessons, "out": out} | ({} if start is None else {"start": start})
    chosen = checked(TrainSettings, {**settings, **given}, "train")
    made = _performed("train", chosen, verbose)
    from flows.cli.tables import judgements_table
    from flows.training import FILES

    typer.echo(judgements_table(made.judgements))
    typer.echo(f"weights  {chosen.out / FILES['weights']}")
    typer.echo(f"report   {chosen.out / FILES['report']}")


@app.command(rich_help_panel=CORPORA)
@with_options(
    "chunks", "out", "models", *TRAIN, *SUPERVISE, of=RetrainSettings, common=COMMON["retrain"]
)
def retrain(
    settings: dict,
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="TOML file with any of the settings.")
    ] = None,
    every: Annotated[
        float | None, typer.Option(help="Seconds: do it again and again, until stopped.")
    ] = None,
    cron: Annotated[
        str | None, typer.Option(help="Times to do it at, as cron writes them: '0 3 * * *'.")
    ] = None,
    verbose: Verbose = False,
) -> None:
    """Learn what is new in a corpus; use it if it is better.

    New chunks are ingested and supervised, and a candidate is trained from the weights in use. It
    is put to use if it is better on held-out clips, beyond noise. Every version is kept; see
    `versions`. --every and --cron wait for their times, which needs `prefect server start` and
    PREFECT_API_URL. A file has chunks, out, models, store and other settings; options win over it.

    \b
    slgaussian retrain --chunks chunks/train --out corpus --models models
    slgaussian retrain retrain.toml --cron "0 3 * * *"
    slgaussian field a.png b.png --cameras transforms.json --lifting branch \\
        --branch-weights models -o field/
    """
    from flows.training_settings import read_retraining

    chosen = read_retraining(config, settings)
    if every is not None or cron is not None:
        from flows.runners.environment import home_of, prepare
        from slgaussian.storage.store import ArtifactStore

        prepare(home_of(ArtifactStore(chosen.store)))
        from flows.schedule import serve

        serve(config, settings, every, cron)
        return

    learnt, prepared = _performed("retrain", chosen, verbose)
    if prepared.failures:
        file = chosen.out / "failures.parquet"
        typer.echo(f"left out: {len(prepared.failures)}; see {file}", err=True)
    typer.echo(learnt.said)


@app.command(rich_help_panel=CORPORA)
def versions(
    models: Annotated[Path, typer.Argument(metavar="MODELS", help="Folder of versions.")],
    use: Annotated[int | None, typer.Option(help="Put the version of this number to use.")] = None,
    roll_back: Annotated[
        bool, typer.Option("--roll-back", help="Put to use what the one in use was trained from.")
    ] = False,
) -> None:
    """List the weights that `retrain` keeps, or switch to others.

    \b
    slgaussian versions models
    slgaussian versions models --use 3
    slgaussian versions models --roll-back
    """
    from flows.cli.tables import versions_table
    from slgaussian.semantic.versions import Versions

    kept = Versions(models)
    known = {version.number: version for version in kept.all()}
    if use is not None and roll_back:
        raise InputError("versions: --use and --roll-back are two ways; choose one")
    if use is not None:
        if use not in known:
            numbers = ", ".join(map(str, known)) or "none"
            raise InputError(f"--use: found {use}, expected one of the versions there: {numbers}")
        kept.use(known[use])
    if roll_back:
        kept.roll_back()
    typer.echo(versions_table(known.values(), kept.current()) if known else f"{models}: no version")


@app.command(rich_help_panel=UPKEEP)
@with_options("store", "runner", *FILES, "clip.precision", common=COMMON["doctor"])
def doctor(
    settings: dict,
    places: Annotated[
        list[str] | None,
        typer.Argument(metavar="PLACE", help="With --models: folder, file or name of a model."),
    ] = None,
    models: Annotated[
        bool, typer.Option("--models", help="Load models of CLIP, SAM and SAM 2, and try them.")
    ] = False,
) -> None:
    """Check what a run needs, and say what to do about it.

    Looks at packages, threads, the store, the Prefect server and the files that options name, and
    says of each: ok, BAD with what to do, or -- for what is missing and need not be there. Nothing
    is downloaded. The exit status is 1 if anything is BAD. With --models, it loads those of the
    PLACEs and options, or all in the hub's cache, and asks each what any real one knows.

    \b
    slgaussian doctor
    slgaussian doctor --store s3://bucket/slg --runner dask://10.0.0.5:8786
    slgaussian doctor --encoder clip --clip-model models/clip-vit-b-16
    slgaussian doctor --models models/clip-vit-b-16 facebook/sam-vit-base
    """
    from flows.settings import make_settings

    if places and not models:
        raise InputError(f"doctor: found {places[0]!r}, which is for --models; add that, or a part")
    if models:
        from flows.cli.model_checks import examine_models

        found = examine_models(places or [], settings)
    else:
        from flows.cli.doctor import examine

        found = examine(make_settings(settings, "doctor"), "runner" in settings)
    healthy = True
    for finding in found:
        healthy &= finding.good is not False
        mark = {True: "ok ", False: "BAD", None: "-- "}[finding.good]
        typer.echo(f"{mark}  {finding.name:<12} {finding.said}")
    raise typer.Exit(0 if healthy else 1)


@app.command(rich_help_panel=UPKEEP)
def parts(
    as_json: Annotated[bool, typer.Option("--json", help="Print them as JSON.")] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of a configuration file.")
    ] = False,
) -> None:
    """List the parts of the method, with their settings.

    Also those that other packages bring. What a file, folder or model holds decides what is
    computed anew, not where it is.

    \b
    slgaussian parts
    slgaussian parts --json
    slgaussian parts --schema
    """
    from flows.cli import parts as known

    if as_json and schema:
        raise InputError("parts: --json and --schema are two outputs; choose one")
    typer.echo(known.schema() if schema else known.as_json() if as_json else known.listed())


def main() -> None:
    """Run the command line; errors meant for users end in one sentence and exit status 2."""
    try:
        with compiling.told_to(Waiting(sys.stderr)):
            status = app(prog_name="slgaussian", standalone_mode=False)
    except TyperException as error:
        typer.echo(f"error: {told(error)}", err=True)
        raise SystemExit(error.exit_code) from None
    except SLGaussianError as error:
        typer.echo(f"error: {error}", err=True)
        raise SystemExit(2) from None
    raise SystemExit(status or 0)


def _run(command: str, settings: Any, verbose: bool) -> None:
    finished = _performed(command, settings, verbose)
    from flows.cli.tables import scores_tables, view_counts_tables

    if finished.counts:
        typer.echo(view_counts_tables(finished.counts))
    if finished.results:
        typer.echo(scores_tables(finished.results))
    if finished.report is not None:
        typer.echo(f"report: {finished.report}")
    if finished.failures:
        left_out = ", ".join(failure.scene for failure in finished.failures)
        typer.echo(f"left out: {left_out}; see {settings.out / 'failures.parquet'}", err=True)
    if finished.ready:
        typer.echo(f"look at it: {finished.look}")
        typer.echo(finished.ready)
    if finished.failures:
        raise typer.Exit(1)


def _prepare(command: str, values: dict[str, Any], verbose: bool) -> None:
    from flows.corpus_settings import make_corpus_settings

    settings = make_corpus_settings(values, command)
    made = _performed(command, settings, verbose)
    from flows.corpus import FILES

    for stage, count in made.rows.items():
        file = settings.out / FILES[stage]
        typer.echo(f"{count} {file.stem}  {file}")
    if made.failures:
        first = made.failures[0]
        typer.echo(
            f"left out: {len(made.failures)}, the first at {first.stage}: {first.reason}; all are "
            f"in {settings.out / 'failures.parquet'}",
            err=True,
        )
        raise typer.Exit(1)


def _performed(command: str, settings: Any, verbose: bool) -> Any:
    from flows.runners.commands import perform
    from flows.runners.environment import interruptible

    with interruptible():
        return perform(command, settings, verbose)
