"""The commands `slgaussian render | view | export`, with lazy imports."""

from __future__ import annotations

import os
import signal
import sys
import webbrowser
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from flows.cli import options
from slgaussian.errors import InputError, did_you_mean

if TYPE_CHECKING:
    import numpy as np

    from slgaussian.field import SemanticField
    from slgaussian.gaussians import Gaussians
    from slgaussian.scene import Camera


class Shot(NamedTuple):
    """Rendering of a source: uint8 [H, W, 3], float32 [H, W], int32 [H, W] or None."""

    rgb: np.ndarray
    depth: np.ndarray
    ids: np.ndarray | None


def render(
    source: options.FieldOrGaussians,
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture: .png or .jpg; video: .mp4.")],
    view: options.Views = None,
    between: options.Between = None,
    camera: options.CameraFile = None,
    orbit: Annotated[
        int | None, typer.Option(metavar="N", min=2, max=2000, help="Render an orbit of N frames.")
    ] = None,
    path: Annotated[
        Path | None, typer.Option(help="Render a frame from each camera of a JSON file.")
    ] = None,
    depth: Annotated[
        Path | None, typer.Option(help="Also write z-depth: .npy or .png (thousandths).")
    ] = None,
    ids: Annotated[Path | None, typer.Option(help="Also write object ids: a .png.")] = None,
    show: Annotated[
        str, typer.Option(help="Content: colours, or codes (the paper's feature maps).")
    ] = "colours",
) -> None:
    """Render a field, or any .ply or .spz of Gaussians, from a camera.

    A field has cameras; for Gaussians, give cameras in their world with --camera. A --path is a
    camera path of nerfstudio's viewer, or a transforms.json. Depth is 0 where there is no surface,
    and ids are 16-bit numbers, 0 for none; both are written for one view only.

    \b
    slgaussian render field/ -o picture.png --view 1 --depth depth.npy --ids ids.png
    slgaussian render field/ -o middle.png --between 0 1 0.5
    slgaussian render field/ -o codes.png --between 0 1 0.5 --show codes
    slgaussian render field/ -o turn.mp4 --orbit 60
    slgaussian render field/ -o flight.mp4 --path camera_path.json
    slgaussian render scene.ply --camera transforms.json -o picture.png
    """
    from flows.cli.open_field import choose_cameras
    from flows.cli.pictures import FILMS, PICTURES, check_picture, write_film, write_picture
    from slgaussian.cameras import paths
    from slgaussian.datasets.recognise import cameras_in
    from slgaussian.field import SemanticField
    from slgaussian.formats.depth_maps import WRITABLE_SUFFIXES, write_map
    from slgaussian.formats.splats import READERS, load_gaussians
    from slgaussian.io import write_file
    from slgaussian.masks.precomputed import encode_ids

    if show not in ("colours", "codes"):
        raise InputError(f"--show: found {show!r}, expected colours or codes")
    film = orbit is not None or path is not None
    check_picture(out, FILMS if film else PICTURES)
    ways = {"--orbit": orbit, "--path": path, "--view": view, "--between": between}
    chosen = [name for name, value in ways.items() if value]
    if film and chosen[1:]:
        raise InputError(f"{chosen[0]} and {chosen[1]}: both choose cameras; leave out one of them")
    for name, file, kinds in (("--depth", depth, WRITABLE_SUFFIXES), ("--ids", ids, (".png",))):
        if file is not None and (film or len(view or ()) > 1):
            raise InputError(f"{name}: is of one view; leave out {chosen[0]}, or name one view")
        if file is not None:
            check_picture(file, kinds)
    suffix = source.suffix.lower()
    is_file = suffix in READERS and not source.is_dir()
    if is_file and (ids is not None or show == "codes"):
        raise InputError(f"{source}: a {suffix} has no objects; leave out --ids and --show")
    if is_file and camera is None and path is None:
        raise InputError(
            f"{source}: a {suffix} has no cameras; add --camera transforms.json, in the world of "
            f"the {suffix}, and --view with the name of one of its frames"
        )
    if is_file:
        gaussians, _ = load_gaussians(source)
        if not len(gaussians):
            raise InputError(f"{source}: has no Gaussians, so there is nothing to render")
        look = partial(_look_at_gaussians, gaussians, source)
        cameras: Mapping[str, Camera] = {}
    else:
        field = SemanticField.load(source)
        gaussians, cameras = field.gaussians, field.cameras
        look = partial(_look_at_field, field, show == "codes")
    if path is not None:
        shots = dict(cameras_in(path))
        if len({(shot.width, shot.height) for shot in shots.values()}) > 1:
            raise InputError(f"{path}: has cameras of several sizes, and a video has one")
    elif orbit is not None:
        cameras = cameras if camera is None else cameras_in(camera)
        points = gaussians.means.numpy() + gaussians.origin
        turn = paths.orbit(list(cameras.values()), points, orbit)
        shots = {f"turn {number} of {orbit}": shot for number, shot in enumerate(turn, 1)}
    else:
        shots = choose_cameras(source, cameras, view, camera, between)
    rendered = map(look, shots.values())
    if film:
        write_film(out, (shot.rgb for shot in rendered))
    else:
        pictures = list(rendered)
        write_picture(out, *(shot.rgb for shot in pictures))
        if depth is not None:
            unit = write_map(depth, pictures[0].depth)
            if depth.suffix.lower() == ".png":
                typer.echo(f"{depth}: 1 is {unit:g} scene units", err=True)
        if ids is not None and (labels := pictures[0].ids) is not None:
            write_file(ids, encode_ids(labels)[1])
    typer.echo(out)


def _look_at_field(field: SemanticField, codes: bool, camera: Camera) -> Shot:
    import numpy as np

    rendered, rgb = field.render(camera), np.zeros((camera.height, camera.width, 3), np.uint8)
    if codes:
        drawn = np.rint(field.render_codes(camera).clip(0, 1) * 255)
        rgb[..., : drawn.shape[-1]] = drawn
    return Shot(rgb if codes else rendered.rgb, rendered.depth, rendered.ids)


def _look_at_gaussians(gaussians: Gaussians, file: Path, camera: Camera) -> Shot:
    """Render Gaussians; warn if hardly any are visible."""
    import numpy as np

    from slgaussian.labels import MIN_WEIGHT
    from slgaussian.rasterize.picture import compute_view_colours, picture

    rendered = picture(gaussians, compute_view_colours(gaussians, camera), camera)
    visible = rendered.alpha >= MIN_WEIGHT
    if not visible.any():
        median = gaussians.means.median(0).values.numpy() + gaussians.origin
        middle = ", ".join(f"{x:.3g}" for x in median.tolist())
        typer.echo(
            f"hardly anything of {file} is in view: the middle of its {len(gaussians)} Gaussians "
            f"is at ({middle}), the camera at "
            f"({', '.join(f'{x:.3g}' for x in camera.center)}); do both use one world?",
            err=True,
        )
    # On black, as such files are trained; mean depth is meaningless where alpha is low.
    rgb = np.rint(rendered.values.clip(0, 1) * 255).astype(np.uint8)
    return Shot(rgb, np.where(visible, rendered.depth, 0), None)


@options.add_options()
def view(
    ctx: typer.Context,
    folder: options.Folder,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="[default: 8080, or a free one]")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to bind; 0.0.0.0 for all.")] = "127.0.0.1",
) -> None:
    """View a field in the browser; query and edit its objects.

    Prints the address to open; several users may open and change the same field. Type a word, or
    click an object to see its words, to name it, to teach a word, or to remove it; "Save changes"
    writes the changes to the folder of the field. Ctrl-C stops it.

    \b
    slgaussian view field/
    slgaussian view field/ --port 9000
    """
    from flows.cli.open_field import open_field
    from slgaussian.viewer.auth import listen
    from slgaussian.viewer.page.scene_page import scene_page
    from slgaussian.viewer.server import LiveField, app, serve

    for sign in (signal.SIGINT, signal.SIGTERM):  # SIGINT is ignored in a shell's background
        signal.signal(sign, signal.default_int_handler)
    live = None
    try:
        access = listen(host, port)
        live = LiveField(open_field(folder, ctx, rules=False)[1], folder)
        page = scene_page(live.field, live=True)
        typer.echo(access.address)
        if access.token:
            typer.echo("everybody with this address can see and change the scene", err=True)
        typer.echo("Ctrl-C stops it", err=True)
        if sys.stdout.isatty() and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(access.address)
        serve(app(page, access, live), access)
    except KeyboardInterrupt:
        lost = live is not None and live.unsaved
        typer.echo("\nstopped; changes were not saved" if lost else "\nstopped", err=True)


@options.add_options()
def export(
    ctx: typer.Context,
    folder: options.Folder,
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="File, by its suffix: .html, .ply, .spz, ...; folder for masks."
        ),
    ],
    texts: Annotated[
        list[str] | None,
        typer.Option("--text", help="Further text that a page answers; may be repeated."),
    ] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Write all data of each Gaussian into a .ply.")
    ] = False,
) -> None:
    """Write a field as a web page, or as a file for other viewers.

    A page (.html) opens from disk in any browser, without a network, with queries and object
    selection. It contains small copies of the photographs. A .ply has the 62 columns of 3D Gaussian
    splatting that viewers expect; with --full each Gaussian also has its ID code and weight
    (f_sem_0 and on), its source pixel (source), and its object (label, 0 for none). A .spz and a
    .sog store Gaussians in fewer bytes. A .glb is glTF with KHR_gaussian_splatting, which has the
    object of each Gaussian (_LABEL) and the names of objects. A .usda, .usdc or .usdz (OpenUSD) and
    a .rrd (Rerun) also have the cameras of the views. The masks.parquet of a run becomes a folder
    of PNG files, METHOD/PROTOCOL/SCENE/FRAME/QUERY.png.

    \b
    slgaussian export field/ -o scene.html
    slgaussian export field/ -o scene.spz
    slgaussian export field/ -o scene.ply --full
    slgaussian export results/masks.parquet -o masks
    """
    from flows.cli.open_field import open_field
    from slgaussian.field import SemanticField
    from slgaussian.formats.splats import WRITERS, save_gaussians
    from slgaussian.io import write_file
    from slgaussian.objects import name_objects
    from slgaussian.viewer.page.scene_page import scene_page

    if full and out.suffix.lower() != ".ply":
        raise InputError(f"{out}: --full is for .ply files; leave it out")
    if folder.suffix == ".parquet" and not texts:
        from slgaussian.benchmark.outputs import export_masks

        typer.echo(f"{out}: {export_masks(folder, out)} masks")
        return
    suffix, suffixes = out.suffix.lower(), (".html", *WRITERS)
    if suffix not in suffixes:
        raise InputError(
            f"{out}: found {repr(out.suffix) if suffix else 'no suffix'}, expected the name of the "
            f"file to end in {', '.join(suffixes[:-1])} or {suffixes[-1]}"
            f"{did_you_mean(suffix, suffixes)}"
        )
    if suffix != ".html" and texts:
        raise InputError(f"{out}: --text is for pages (.html); leave it out")
    if suffix == ".html":
        _, field = open_field(folder, ctx, rules=False)
        data = scene_page(field.drop_hidden(), _photographs(folder, field), texts or []).encode()
        write_file(out, data)
        size = f"{len(data) / 1e6:.1f} MB"
        typer.echo(f"{size}, to open in any browser, without a network", err=True)
    else:
        field, names = SemanticField.load(folder).drop_hidden(), None
        if suffix == ".glb":
            opened = open_field(folder, ctx, rules=False)[1]
            names = name_objects(opened.reader) | dict(opened.edits.names)
        save_gaussians(field.gaussians, out, field.labels(), field.cameras, full, names)
    typer.echo(out)


def _photographs(folder: Path, field: SemanticField) -> dict[str, np.ndarray]:
    """Read the photographs of a field that are still at their paths, by view."""
    from slgaussian.datasets.photographs import open_photograph
    from slgaussian.io import file_digest
    from slgaussian.storage.field_folder import read_photographs

    images = {}
    for name, (file, digest) in read_photographs(folder).items():
        try:
            if name in field.cameras and file_digest(file) == digest:
                images[name], _ = open_photograph(file, upright=True)
        except (InputError, OSError):  # moved or changed; the page shows a rendering instead
            continue
    return images
