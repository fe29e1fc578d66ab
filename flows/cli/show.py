"""The commands `slgaussian render | view | export`. Heavy imports wait until one is given."""

from __future__ import annotations

import os
import signal
import sys
import webbrowser
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from flows.cli import options
from flows.config import Method
from slgaussian.errors import InputError, did_you_mean

if TYPE_CHECKING:
    import numpy as np

    from slgaussian.field import SemanticField
    from slgaussian.gaussians import Gaussians
    from slgaussian.scene import Camera

    Panels = tuple[np.ndarray, np.ndarray, list[tuple[str, np.ndarray]]]

EXPORTS = (".html", ".ply", ".spz")


def render(
    source: options.FieldOrPly,
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture: .png or .jpg.")],
    view: options.Views = None,
    between: options.Between = None,
    camera: options.CameraFile = None,
    orbit: Annotated[
        int | None, typer.Option(metavar="N", min=2, max=2000, help="Draw a turn of N frames.")
    ] = None,
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
    from flows.cli.open_field import choose_cameras
    from flows.cli.pictures import FILMS, PICTURES, check_picture, write_film, write_picture
    from slgaussian.benchmark import pictures
    from slgaussian.cameras import paths
    from slgaussian.datasets.recognise import cameras_in
    from slgaussian.field import SemanticField
    from slgaussian.formats.ply import load_ply

    check_picture(out, PICTURES if orbit is None else FILMS)
    if orbit is not None and (view or between):
        raise InputError("--orbit: is a way to look of its own; leave out --view and --between")
    if source.suffix.lower() != ".ply" or source.is_dir():
        field = SemanticField.load(source)
        cameras = field.cameras if camera is None else cameras_in(camera)
        points, panels = field.gaussians.means, partial(_field_panels, field)
    else:
        if camera is None:
            raise InputError(
                f"{source}: a .ply has no cameras; add --camera transforms.json, in the world of "
                "the .ply, and --view with the name of one of its frames"
            )
        gaussians, _ = load_ply(source)
        if not len(gaussians):
            raise InputError(f"{source}: holds no Gaussians, so there is nothing to draw")
        cameras = cameras_in(camera)
        points, panels = gaussians.means, partial(_ply_panels, gaussians, source)
    if orbit is None:
        shots = choose_cameras(camera or source, cameras, view, between=between)
    else:
        turn = paths.orbit(list(cameras.values()), points.numpy(), orbit)
        shots = {f"turn {number} of {orbit}": shot for number, shot in enumerate(turn, 1)}
    depths: list[tuple[float, float]] = []

    def draw(name: str) -> np.ndarray:
        rgb, depth, others = panels(shots[name])
        # One scale for all frames, so that a film does not flicker.
        depths.append(depths[0] if depths else pictures.depth_range(depth))
        painted = pictures.paint_depth(depth, *depths[0])
        return pictures.side_by_side([(f"rendering, {name}", rgb), ("depth", painted), *others])

    if orbit is None:
        write_picture(out, *map(draw, shots))
    else:
        write_film(out, map(draw, shots))
    typer.echo(out)


def _field_panels(field: SemanticField, camera: Camera) -> Panels:
    """Return a picture uint8 [H, W, 3], z-depth float [H, W], and further pictures by caption."""
    from slgaussian.benchmark import pictures

    seen = field.render(camera)
    return seen.rgb, seen.depth, [("objects", pictures.paint_labels(seen.ids, seen.rgb))]


def _ply_panels(gaussians: Gaussians, file: Path, camera: Camera) -> Panels:
    """Return the same of Gaussians; warn if hardly any is in view."""
    import numpy as np

    from slgaussian.labels import VISIBLE
    from slgaussian.rasterize.picture import picture, seen_colors

    seen = picture(gaussians, seen_colors(gaussians, camera), camera)
    visible = seen.alpha >= VISIBLE
    if not visible.any():
        middle = ", ".join(f"{x:.3g}" for x in gaussians.means.median(0).values.tolist())
        typer.echo(
            f"hardly anything of {file} is in view: the middle of its {len(gaussians)} Gaussians "
            f"is at ({middle}), the camera at "
            f"({', '.join(f'{x:.3g}' for x in camera.center)}); do both use one world?",
            err=True,
        )
    # Over black, as such files are trained; where little is seen, the mean depth means nothing.
    rgb = np.rint(seen.values.clip(0, 1) * 255).astype(np.uint8)
    return rgb, np.where(visible, seen.depth, 0), []


@options.configured()
def view(
    ctx: typer.Context,
    source: options.FieldOrPly,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="[default: 8080, or a free one]")
    ] = None,
    host: Annotated[str, typer.Option(help="Where to listen; 0.0.0.0 is for all.")] = "127.0.0.1",
) -> None:
    """Look at a scene in the browser; ask it by word and by click.

    Prints the address to open; several people may, and change the same field. Type a word, or click
    a thing to see what it is, to name it, to teach a word for it, or to remove it; Save changes
    writes all that into the folder of the field. A .ply can only be looked at. Ctrl-C ends it.

    \b
    slgaussian view field/
    slgaussian view field/ --port 9000
    slgaussian view scene.ply
    """
    from flows.cli.open_field import open_field
    from slgaussian.formats.ply import load_ply
    from slgaussian.viewer.auth import listen
    from slgaussian.viewer.page.scene_page import gaussians_page, scene_page
    from slgaussian.viewer.server import LiveField, app, serve

    def terminate(number: int, frame: object) -> NoReturn:
        raise KeyboardInterrupt

    # Of both: a shell that starts this in the background has it ignore SIGINT.
    before = {sign: signal.signal(sign, terminate) for sign in (signal.SIGINT, signal.SIGTERM)}
    live = None
    try:
        access = listen(host, port)
        if source.suffix.lower() == ".ply" and not source.is_dir():
            page = gaussians_page(load_ply(source)[0], source.stem)
        else:
            settings = options.settings_from(ctx, Method)
            live = LiveField(open_field(source, settings, rules=False)[1], source)
            page = scene_page(live.field, live=True)
        typer.echo(access.address)
        if access.token:
            typer.echo("whoever has this address sees the scene and can change it", err=True)
        typer.echo("Ctrl-C ends it", err=True)
        if sys.stdout.isatty() and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(access.address)
        serve(app(page, access, live), access)
    except KeyboardInterrupt:
        lost = live is not None and live.unsaved
        typer.echo("\nstopped; changes were not saved" if lost else "\nstopped", err=True)
    finally:
        for sign, handler in before.items():
            signal.signal(sign, handler)


@options.configured()
def export(
    ctx: typer.Context,
    source: options.FieldOrPly,
    out: Annotated[Path, typer.Option("--out", "-o", help="File: .html, .ply or .spz.")],
    texts: Annotated[
        list[str] | None,
        typer.Option("--text", help="What a page shall answer, beside its words; may be repeated."),
    ] = None,
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
    slgaussian export scene.ply -o scene.html
    """
    from flows.cli.open_field import open_field
    from slgaussian.field import SemanticField
    from slgaussian.formats.ply import load_ply, save_ply
    from slgaussian.formats.spz import save_spz
    from slgaussian.io import write_file
    from slgaussian.viewer.page.scene_page import gaussians_page, scene_page

    suffix = out.suffix.lower()
    if suffix not in EXPORTS:
        raise InputError(
            f"{out}: found {repr(out.suffix) if suffix else 'no suffix'}, expected the name of the "
            f"file to end in {', '.join(EXPORTS[:-1])} or {EXPORTS[-1]}"
            f"{did_you_mean(suffix, EXPORTS)}"
        )
    if suffix != ".html" and texts:
        raise InputError(f"{out}: --text is for pages (.html); leave it out")
    field = labels = None
    if source.suffix.lower() == ".ply" and not source.is_dir():
        if texts:
            raise InputError(f"{source}: a .ply answers no words; leave out --text")
        if suffix == ".ply":
            raise InputError(f"{source}: is a .ply already; name another format")
        gaussians, _ = load_ply(source)
    else:
        if suffix == ".html":
            settings = options.settings_from(ctx, Method)
            _, field = open_field(source, settings, rules=False)
        else:
            field = SemanticField.load(source)
        field = field.dropped()
        gaussians, labels = field.gaussians, field.labels()
    if suffix == ".ply":
        save_ply(gaussians, out, labels)
    elif suffix == ".spz":
        save_spz(gaussians, out)
    else:
        if field is None:
            page = gaussians_page(gaussians, source.stem)
        else:
            page = scene_page(field, _photographs(source, field), texts or [])
        data = page.encode()
        write_file(out, data)
        size = f"{len(data) / 1e6:.1f} MB"
        typer.echo(f"{size}, to open in any browser, without a network", err=True)
    typer.echo(out)


def _photographs(folder: Path, field: SemanticField) -> dict[str, np.ndarray]:
    """Read the photographs of a field that are still where they were, by view."""
    from slgaussian.datasets.photographs import open_photograph
    from slgaussian.io import file_digest
    from slgaussian.storage.inputs import read_photographs

    images = {}
    for name, (file, digest) in read_photographs(folder).items():
        try:
            if name in field.cameras and file_digest(file) == digest:
                images[name], _ = open_photograph(file, upright=True)
        except (InputError, OSError):  # it was moved; what the field drew is shown
            continue
    return images
