"""The command line. Heavy imports wait until a command needs them: `--help` answers at once."""

from pathlib import Path
from typing import Annotated, Any

import typer

from flows.options import with_options
from slgaussian.errors import SLGaussianError

METHOD = (
    "size", "near", "far", "predictor", "proposer", "tracker", "encoder", "codes", "lifting",
    "replicas", "temperature", "threshold", "seed", "mvsplat", "sam", "sam2", "sam2_video",
    "precomputed",
)  # fmt: skip
BUILD = tuple(name for name in METHOD if name not in ("temperature", "threshold"))
RUN = (*METHOD, "store", "workers", "method")

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
    help="Two posed photographs in, a 3D scene of Gaussians that answers words out. Start with "
    "`slgaussian demo`; `slgaussian COMMAND --help` has examples.",
)

Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="A line for every stage.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]
Folder = Annotated[Path, typer.Argument(metavar="FIELD", help="Folder that `field` wrote.")]
ViewName = Annotated[
    str, typer.Option("--view", help="Context view by name, or its number from 0.")
]


@app.command()
@with_options(*RUN)
def demo(settings: dict, out: Out = Path("slg-demo"), verbose: Verbose = False) -> None:
    """Run the whole job on scenes that ship with the installation, and write a report.

    A real stereo pair with true depth and three made-up rooms in which everything is known. Takes
    a few minutes; a second time what is unchanged comes from the store.

    \b
    slgaussian demo
    slgaussian demo -o report --store /data/slg --workers 1
    """
    from flows.demo import demo_scenes
    from flows.settings import make_settings

    _run(make_settings({**settings, "out": out, "scenes": demo_scenes()}, "demo"), verbose)


@app.command()
@with_options(*RUN)
def benchmark(
    settings: dict,
    data: Annotated[Path, typer.Option(help="Folder with transforms.json and photographs.")],
    pairs: Annotated[Path, typer.Option(help="JSON: scene -> context, target, categories.")],
    labels: Annotated[Path, typer.Option(help="Folder of LERF-OVS JSON labels, one a frame.")],
    out: Out = Path("slg-benchmark"),
    verbose: Verbose = False,
) -> None:
    """Score a labelled set: a field from each scene's context frames, asked in its target frames.

    Leaves samples.parquet and samples.csv (a row a scene, frame, query), report.html, every
    predicted mask under predictions/, and failures.parquet with the scenes that could not be done.

    \b
    slgaussian benchmark --data office --pairs office/pairs.json --labels office/labels -o scores
    """
    from flows.settings import make_settings

    given = {"data": data, "pairs": pairs, "labels": labels, "out": out}
    _run(make_settings({**settings, **given}, "benchmark"), verbose)


@app.command()
@with_options(*RUN)
def run(
    settings: dict,
    config: Annotated[Path, typer.Argument(help="TOML file with any of the settings.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results.")] = None,
    verbose: Verbose = False,
) -> None:
    """Run a configuration file; options given here win over the file.

    Paths in the file are relative to the file. A scene names its photographs in the camera file:

    \b
    out = "results"
    replicas = 5
    [[scenes]]
    name = "kitchen"
    path = "kitchen/transforms.json"
    context = ["0001.png", "0009.png"]
    targets = ["0005.png"]
    queries = ["red kettle", "wooden table"]
    """
    from flows.settings import read_toml

    _run(read_toml(config, settings if out is None else {**settings, "out": out}), verbose)


@app.command()
@with_options(*BUILD)
def field(
    settings: dict,
    photos: Annotated[list[str], typer.Argument(help="Two or more photographs.")],
    cameras: Annotated[Path, typer.Option(help="transforms.json that has their cameras.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field.")] = Path("field"),
) -> None:
    """Build a field from two or more posed photographs.

    \b
    slgaussian field a.png b.png --cameras transforms.json -o field/
    slgaussian query field/ "red basket" -o hit.png
    """
    from flows.fields import build

    made = build(photos, cameras, out, settings)
    typer.echo(made)


@app.command()
def query(
    field: Folder,
    text: Annotated[str, typer.Argument(help='What to look for, such as "red basket".')],
    view: ViewName = "0",
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Picture of the answer.")] = None,
    temperature: Annotated[float, typer.Option(help="Of the relevancy.")] = 10.0,
    threshold: Annotated[
        float | None, typer.Option(help="Relevancy above which objects are selected.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")] = False,
) -> None:
    """Ask a field for words, seen from one of its context cameras.

    \b
    slgaussian query field/ "red basket" -o hit.png
    slgaussian query field/ "blue carpet" --view 1 --json
    """
    import json

    from flows.fields import ask

    answer = ask(field, text, view, out, temperature, threshold)
    typer.echo(json.dumps(answer) if as_json else _spoken(answer))


@app.command()
def words() -> None:
    """List the words that the lexicon knows, by family, synonyms in brackets.

    \b
    slgaussian words
    """
    from slgaussian.language.vocabulary import load_vocabulary

    for family, spellings in load_vocabulary().families().items():
        listed = (f"{name} ({', '.join(o)})" if o else name for name, o in spellings.items())
        typer.echo(f"{family}: {', '.join(listed)}")


@app.command()
def render(
    source: Annotated[
        Path,
        typer.Argument(metavar="FIELD|PLY", help="Folder that `field` wrote, or any 3DGS .ply."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG file.")],
    cameras: Annotated[
        Path | None,
        typer.Option(help="transforms.json with the cameras of a .ply, or new ones of a field."),
    ] = None,
    view: Annotated[str, typer.Option("--view", help="View by name, or its number from 0.")] = "0",
) -> None:
    """Render a field, or a .ply of Gaussians that anybody made; no GPU is needed.

    Colour and depth; of a field its objects too, and from one of its own cameras unless others are
    given. A .ply comes without cameras: theirs must be in its world, photographs are not needed.

    \b
    slgaussian render field/ -o picture.png --view 1
    slgaussian render scene.ply --cameras transforms.json --view 0007.png -o picture.png
    """
    from flows.fields import picture

    picture(source, cameras, view, out)
    typer.echo(out)


@app.command()
def export(
    field: Folder,
    out: Annotated[Path, typer.Option("--out", "-o", help=".ply file.")],
) -> None:
    """Write a field as a standard 3DGS .ply that viewers open.

    Beside what viewers read, each Gaussian has its code times its weight and that weight (f_sem_0
    to f_sem_3), the pixel that it came from (source) and its object (label, 0 for none).

    \b
    slgaussian export field/ -o scene.ply
    slgaussian render scene.ply --cameras transforms.json -o picture.png
    """
    from flows.fields import to_ply

    to_ply(field, out)
    typer.echo(out)


@app.command()
@with_options("store")
def doctor(settings: dict) -> None:
    """Check the installation: versions, threads, the store and the Prefect server.

    \b
    slgaussian doctor --store /data/slg
    """
    from flows.doctor import examine
    from flows.settings import make_settings

    healthy = True
    for name, found, good in examine(make_settings(settings, "doctor").store):
        healthy &= good
        typer.echo(f"{'ok ' if good else 'BAD'}  {name:<12} {found}")
    raise typer.Exit(0 if healthy else 1)


def main() -> None:
    """Run the command line; errors meant for users end in one sentence and exit status 2."""
    try:
        app()
    except SLGaussianError as error:
        typer.echo(f"error: {error}", err=True)
        raise SystemExit(2) from None


def _run(settings: Any, verbose: bool) -> None:
    from flows.environment import orchestration
    from slgaussian.store import ArtifactStore

    store = ArtifactStore(settings.store)
    with orchestration(store) as ready:
        from flows import pipeline
        from flows.tables import scores_table

        ready()
        try:
            finished = pipeline.run(settings, store, verbose)
        except KeyboardInterrupt:
            typer.echo("\nstopped; the same command goes on from here", err=True)
            raise
    if finished.results:
        typer.echo(scores_table(finished.results))
    if finished.report is not None:
        typer.echo(f"report: {finished.report}")
    if finished.failures:
        left_out = ", ".join(failure.scene for failure in finished.failures)
        typer.echo(f"left out: {left_out}; see {settings.out / 'failures.parquet'}", err=True)
        raise typer.Exit(1)


def _spoken(answer: dict) -> str:
    lines = [f"score  {answer['score']:.3f}  (0.5 is as good as any phrase)"]
    point = answer["point"]
    lines.append("point  " + ("none" if point is None else f"x {point[0]}, y {point[1]}"))
    found = ", ".join(f"{o['id']} ({o['relevancy']:.3f})" for o in answer["objects"])
    lines.append(f"objects  {found or 'none'}")
    if answer["unknown"]:
        lines.append(f"not known and left out: {', '.join(answer['unknown'])}")
    if answer["picture"]:
        lines.append(f"picture  {answer['picture']}")
    return "\n".join(lines)
