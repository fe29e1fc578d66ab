"""The commands `slgaussian demo | field | cameras | masks`."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from flows.cli import options
from flows.cli.run import run_scenes
from flows.read_config import make_settings
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.cameras.estimated import EstimatedCameras
MASKS_FILE = "masks.json"
"""File in a folder of masks with their settings."""
MaskFormat = Literal["ids", "gaussian-grouping", "langsplat", "coco", "coco-polygons"]
PREVIEW_FILE = "look.jpg"
"""Picture of the masks for viewing; a JPEG, as view names end in .png."""


@options.add_options("preset", "encoder", "seed", *options.ENGINE)
def demo(
    ctx: typer.Context,
    out: options.Out = Path("slg-demo"),
    verbose: options.Verbose = False,
) -> None:
    """Run and score the whole pipeline on example scenes.

    The scenes are a stereo pair with true depth, and three procedural rooms with full ground truth.
    Takes one or two minutes, writes a report and a field of every scene, and prints a command that
    queries the stereo pair. Running it again reads all unchanged results from the store.

    \b
    slgaussian demo
    slgaussian query slg-demo/fields/motorcycle "grey floor" -o hit.png
    slgaussian demo --preset fast --store /data/slg -o fast
    """
    from flows.scenes import demo_scenes

    values = options.settings_from(ctx, scenes=demo_scenes())
    run_scenes("demo", make_settings(values, "demo"), verbose)


@options.add_options("preset", "size", *options.COMPONENTS, "encoder")
def field(
    ctx: typer.Context,
    photos: Annotated[
        list[str], typer.Argument(metavar="PHOTO|SPLAT", help="Photographs, or a .ply or .spz.")
    ],
    cameras: options.Cameras = None,
    photographs: Annotated[
        list[str] | None, typer.Option(help="Photographs of a splat; may be repeated.")
    ] = None,
    keyframes: Annotated[
        int | None, typer.Option(metavar="N", min=2, help="Use N sharp photographs of a sequence.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the field.")] = Path("field"),
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with status 4 if the scene is poor.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a field of other photographs.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print all warnings, and statistics.")
    ] = False,
) -> None:
    """Build a field from photographs, or from a splat.

    A field is a folder with the Gaussians of the scene and a memory bank, by which texts find its
    objects. `query`, `segment`, `render` and `export` open it. Estimated cameras have no metric
    scale: the distance of the first two is 1.

    A splat stays as it is. Without photographs, views of it are rendered.

    \b
    slgaussian field scene.ply --photographs images/ --cameras sparse/0 -o field/
    slgaussian field walk/*.jpg --cameras sparse/0 --keyframes 24 -o field/
    slgaussian field a.jpg b.jpg --encoder clip --set clip.model=models/clip -o field/
    """
    from flows.cli.photographs import begin_work, load_photographs
    from flows.cli.splats import choose_splat
    from slgaussian import precompile
    from slgaussian.build import build_field
    from slgaussian.cameras.quality import POOR, Quality, camera_doubt
    from slgaussian.objects import suggest_word
    from slgaussian.storage.field_folder import (
        check_same_photographs,
        check_target,
        describe_photographs,
    )

    photos, tables = choose_splat(photos, photographs or [], options.settings_from(ctx))
    settings = make_settings(tables, "field")
    check_target(out)  # before the work
    start = time.perf_counter()
    sample, places = load_photographs(photos, cameras, settings, keyframes, verbose)
    if not force:
        check_same_photographs(out, places)
    seconds = {"cameras" if cameras is None else "reading": time.perf_counter() - start}
    precompile.begin()
    method = settings.field_method
    names = [component.name for component in method.components] if verbose else []
    with begin_work("building a field from", sample, names, verbose):
        built = build_field(sample, method, settings.trust_cameras, seconds.__setitem__)
    built.save(out, describe_photographs(places))
    quality = Quality(**built.settings["quality"])
    size_text = f"{len(built.gaussians):,} Gaussians, {len(built.bank)} objects"
    lines = [f"{size_text}, {time.perf_counter() - start:.1f} s"]
    if (views := built.settings.get("views")) is not None:
        used = f"labelled {len(views['names'])} of {len(sample.context)} views, {views['kind']}"
        lines.append(f"{used}: {', '.join(views['names'])}")
        lines.append(f"the splat has {quality.detail:.0%} of their detail, {quality.psnr:.1f} dB")
    if verbose:
        lines += [quality.summary(), *(f"{k}: {v}" for k, v in built.settings["account"].items())]
        steps = ", ".join(f"{step} {spent:.2f}" for step, spent in seconds.items())
        lines.append(f"seconds: {steps}")
    lines.append(quality.verdict().sentence())
    if doubt := camera_doubt(built.settings.get("cameras", {})):
        lines.append(f"warning: {doubt}")
    if advice := built.encoder.advice:
        lines.append(advice)
    if (word := suggest_word(built)) is not None:
        command = ["slgaussian", "query", str(out), word, "-o", "hit.png"]
        lines.append(f"ask it: {shlex.join(command)}")
    lines.append(f"look at it: {shlex.join(['slgaussian', 'view', str(out)])}")
    typer.echo("\n".join(lines), err=True)
    typer.echo(out)
    if strict and quality.verdict().level == POOR:
        raise typer.Exit(4)


def cameras(
    photos: options.Photos,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="transforms.json, a COLMAP folder, or LLFF's poses_bounds.npy."
        ),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(help="colmap, colmap-text, nerfstudio or llff. [default: by the suffix]"),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Estimate the cameras of photographs.

    Prints a row for each pair: matches, inliers of its pose, parallax angle and uncertainty of the
    pose in degrees, and a verdict. The world is that of the first camera; the distance of the first
    two is 1. A transforms.json or COLMAP folder contains all this too, and `--cameras` reads it.
    COLMAP's and LLFF's cameras are those of the photographs as stored, before EXIF turns them.

    \b
    slgaussian cameras a.jpg b.jpg -o transforms.json
    slgaussian field photos/a.jpg photos/b.jpg --cameras transforms.json -o field/
    slgaussian cameras scene/images -o scene/sparse/0
    """
    from flows.cli.photographs import print_warnings
    from slgaussian.datasets import unposed
    from slgaussian.datasets.camera_files import check_target, write_cameras

    if out is None and format is not None:
        raise InputError(f"format: found {format!r} without a file; give one by -o")
    chosen = "" if out is None else check_target(out, format)
    files = unposed.name_files(photos)
    estimate = unposed.find(files)
    if out is not None:
        write_cameras(out, chosen, files, estimate)
    doubts = [f"these cameras are doubtful: {estimate.doubt}"] if estimate.doubt else []
    print_warnings([*doubts, *estimate.warnings], verbose=True)
    typer.echo(estimate.summary(), err=True)
    typer.echo(json.dumps(estimate.as_json()) if as_json else _pairs_text(estimate))
    if out is not None and not as_json:
        typer.echo(out)


def _pairs_text(estimate: EstimatedCameras) -> str:
    """Tabulate the pairs of photographs: matches, inliers, angles and verdict."""
    from slgaussian.benchmark.reports.text_table import table_text

    place = {name: number for number, name in enumerate([*estimate.cameras, *estimate.left_out])}
    rows: list[Sequence[str]] = [("pair", "matches", "agree", "angle", "off by", "verdict")]
    for pair in sorted(estimate.pairs, key=lambda pair: [place[name] for name in pair.views]):
        angles = (f"{a:.1f}" if isfinite(a) else "" for a in (pair.angle, pair.uncertainty))
        verdict = pair.verdict + (f": {pair.reason}" if pair.reason else "")
        views = " - ".join(pair.views)
        rows.append((views, str(pair.matches), str(pair.inliers), *angles, verdict))
    return table_text(rows, "<>>>><")


@options.add_options("preset", "size", *options.COMPONENTS, "encoder")
def masks(
    ctx: typer.Context,
    photos: options.Photos,
    cameras: options.Cameras = None,
    format: Annotated[
        MaskFormat,
        typer.Option(
            metavar="<format>",
            help="Layout of the files: ids, gaussian-grouping, langsplat, coco or coco-polygons.",
        ),
    ] = "ids",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the masks.")] = Path("ids"),
) -> None:
    """Label the objects of photographs consistently in all views.

    Writes a label map of each view, a 16-bit grey PNG of object ids, 0 for none, and look.jpg for
    viewing. The tracker precomputed reads the maps, which you may edit before building a field.
    Other formats have the size of the photographs; the encoder gives LangSplat's features and the
    words of COCO's categories.

    \b
    slgaussian masks a.jpg b.jpg -o ids/
    slgaussian masks a.jpg b.jpg --cameras transforms.json --proposer sam -o ids/
    slgaussian masks a.jpg b.jpg --format coco -o masks/
    slgaussian field a.jpg b.jpg --tracker precomputed --set precomputed.folder=ids/ -o field/
    """
    from flows.cli.photographs import begin_work, load_photographs
    from slgaussian.benchmark import pictures
    from slgaussian.benchmark.reports.text_table import table_text
    from slgaussian.build import build_memory_bank, label_photographs, record_estimation
    from slgaussian.cameras.quality import camera_doubt
    from slgaussian.components.method import BuildConfig, Method
    from slgaussian.formats import coco_writer, mask_layouts
    from slgaussian.io import atomic_folder
    from slgaussian.language.scoring import BankReader
    from slgaussian.masks.precomputed import write_ids
    from slgaussian.objects import name_objects
    from slgaussian.storage.field_folder import check_target

    settings = make_settings(options.settings_from(ctx), "masks")
    check_target(out, MASKS_FILE, "a folder of masks")  # before the work
    sample, _ = load_photographs(photos, cameras, settings)
    if format in ("gaussian-grouping", "langsplat"):
        mask_layouts.loader_names(sample.context)
    encodes = format not in ("ids", "gaussian-grouping")
    if ctx.params["encoder"] and not encodes:
        raise InputError(f"masks: --encoder has no use for --format {format}; leave it out")
    kinds = (*options.COMPONENTS, "encoder") if encodes else options.COMPONENTS
    components = [settings.configure(kind) for kind in kinds]
    method = Method(*components, **dict(BuildConfig.of(settings)))
    start = time.perf_counter()
    with begin_work("labelling", sample, [c.name for c in components], verbose=True):
        sample, predicted, maps = label_photographs(sample, method, settings.trust_cameras)
        if encodes:
            encoder, drawing = method.encoder.load(), (method.codes.load(), method.seed)
            bank = build_memory_bank(sample, predicted.geometry, maps, encoder, *drawing)
    if doubt := camera_doubt(record_estimation(sample, predicted.quality)):
        typer.echo(f"warning: {doubt}", err=True)
    typer.echo(f"{len(maps.ids)} objects, {time.perf_counter() - start:.1f} s", err=True)

    views, panels = sample.context, []
    rows = [("view", "file", "objects", "labelled")]
    with atomic_folder(out) as draft:
        if format == "ids":
            files = write_ids(draft, views, maps)
        elif format == "gaussian-grouping":
            files = mask_layouts.write_grouping(draft, views, maps)
        elif format == "langsplat":
            files = mask_layouts.write_langsplat(draft, views, maps, bank)
        else:
            words = name_objects(BankReader(bank, encoder))
            files = coco_writer.write_coco(draft, views, maps, words, format == "coco-polygons")
        for view, ids, areas in zip(views, maps.labels, maps.areas().T, strict=True):
            painted = pictures.paint_labels(ids, view.image)
            panels += [(view.name, view.image), ("objects", painted)]
            labelled = f"{100 * (ids > 0).mean():.1f} %"
            rows.append((view.name, files[view.name], str((areas > 0).sum()), labelled))
        look = pictures.side_by_side(panels)
        (draft / PREVIEW_FILE).write_bytes(pictures.encode_jpeg(look, look.shape[1]))
        identities: dict[str, Any] = {c.kind: {c.name: c.identity()} for c in components}
        identities |= {"replicas": method.replicas, "votes": method.votes}
        text = {"size": list(maps.labels.shape[1:]), "views": files, "settings": identities}
        text |= {} if format == "ids" else {"format": format}
        (draft / MASKS_FILE).write_text(json.dumps(text, indent=1) + "\n", "utf-8")
    typer.echo(table_text(rows, "<<"))
    shared = len(maps.ids) - len(maps.seen_once)
    typer.echo(f"{len(maps.ids)} objects, {shared} of them in several views\n{out}")
