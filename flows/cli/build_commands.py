"""The commands that make something of photographs. Heavy imports wait until one is given."""

from pathlib import Path
from typing import Annotated

import typer

from flows.cli.arguments import Out, Verbose
from flows.cli.command_settings import BUILD, COMMON, FIELDS, MASKS, RUN
from flows.cli.help import App
from flows.cli.options import with_options
from flows.cli.running import run_and_say

commands = App()

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


@commands.command(rich_help_panel=FIELDS)
@with_options(*RUN, common=COMMON["demo"])
def demo(settings: dict, out: Out = Path("slg-demo"), verbose: Verbose = False) -> None:
    """Try everything on scenes that come with the installation.

    A stereo pair with true depth, and three made-up rooms in which everything is known. It takes
    one or two minutes, leaves a report and a field of every scene, and ends with a command that
    asks one. Run it again, and what is unchanged comes from the store.

    \b
    slgaussian demo
    slgaussian query slg-demo/fields/room_0 "purple ball" -o hit.png
    slgaussian demo --preset fast --store /data/slg -o fast
    """
    from flows.demo import demo_scenes
    from flows.settings import make_settings

    given = {**settings, "out": out, "scenes": demo_scenes()}
    run_and_say("demo", make_settings(given, "demo"), verbose)


@commands.command(rich_help_panel=FIELDS)
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
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field.")] = Path("field"),
) -> None:
    """Build a field from two or more photographs.

    A field is a folder with the scene as Gaussians and what words need to find its objects.
    `query`, `segment`, `render` and `export` open it. Cameras that are found are in no metres: the
    first two are 1 apart.

    \b
    slgaussian field a.jpg b.jpg -o field/
    slgaussian field walk/*.jpg --cameras sparse/0 --keyframes 24 -o field/
    """
    from flows.cli.fields import build

    typer.echo(build(photos, cameras, refine, keyframes, out, settings))


@commands.command(rich_help_panel=FIELDS)
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


@commands.command(rich_help_panel=FIELDS)
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
