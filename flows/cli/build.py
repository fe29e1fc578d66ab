"""The commands `slgaussian demo | field | cameras | masks`."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows.cli import options
from flows.cli.run import run_scenes
from flows.read_config import make_settings
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.cameras.estimated import EstimatedCameras
MASKS_FILE = "masks.json"
"""File in a folder of masks with their settings."""
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
        used = f"labelled {len(views['used'])} of {len(sample.context)} views, {views['of']}"
        lines.append(f"{used}: {', '.join(views['used'])}")
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
        Path | None, typer.Option("--out", "-o", help="transforms.json, in nerfstudio's format.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Estimate the cameras of photographs.

    Prints a row for each pair: matches, inliers of its pose, parallax angle and uncertainty of the
    pose in degrees, and a verdict. The world is that of the first camera; the distance of the first
    two is 1. A transforms.json contains all this too, and `--cameras` reads it.

    \b
    slgaussian cameras a.jpg b.jpg -o transforms.json
    slgaussian field photos/a.jpg photos/b.jpg --cameras transforms.json -o field/
    """
    from flows.cli.photographs import print_warnings
    from slgaussian.datasets import nerfstudio, unposed

    try:
        is_foreign = (
            out and out.exists() and nerfstudio.EXTENSION_KEY.encode() not in out.read_bytes()
        )
    except OSError as error:
        message = f"{out}: cannot be written ({error.strerror}); choose another"
        raise InputError(message) from None
    if is_foreign:
        raise InputError(
            f"{out}: exists and was not written by `slgaussian cameras`; choose another file, or "
            "remove it"
        )
    files = unposed.name_files(photos)
    estimate = unposed.find(files)
    if out is not None:
        nerfstudio.write(out, files, estimate)
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


@options.add_options("preset", "size", *options.COMPONENTS)
def masks(
    ctx: typer.Context,
    photos: options.Photos,
    cameras: options.Cameras = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the maps.")] = Path("ids"),
) -> None:
    """Label the objects of photographs consistently in all views.

    Writes a label map of each view, a 16-bit grey PNG of object ids, 0 for none, and look.jpg for
    viewing. The tracker precomputed reads the maps, which you may edit before building a field.

    \b
    slgaussian masks a.jpg b.jpg -o ids/
    slgaussian masks a.jpg b.jpg --cameras transforms.json --proposer sam -o ids/
    slgaussian field a.jpg b.jpg --tracker precomputed --set precomputed.folder=ids/ -o field/
    """
    from flows.cli.photographs import begin_work, load_photographs
    from slgaussian.benchmark import pictures
    from slgaussian.benchmark.reports.text_table import table_text
    from slgaussian.build import label_photographs, record_estimation
    from slgaussian.cameras.quality import camera_doubt
    from slgaussian.components.method import BuildConfig, Method
    from slgaussian.io import atomic_folder
    from slgaussian.masks.precomputed import encode_ids, map_names
    from slgaussian.storage.field_folder import check_target

    settings = make_settings(options.settings_from(ctx), "masks")
    check_target(out, MASKS_FILE, "a folder of masks")  # before the work
    sample, _ = load_photographs(photos, cameras, settings)
    components = [settings.configure(kind) for kind in options.COMPONENTS]
    method = Method(*components, **dict(BuildConfig.of(settings)))
    start = time.perf_counter()
    with begin_work("labelling", sample, [c.name for c in components], verbose=True):
        sample, predicted, maps = label_photographs(sample, method, settings.trust_cameras)
    if doubt := camera_doubt(record_estimation(sample, predicted.quality)):
        typer.echo(f"warning: {doubt}", err=True)
    typer.echo(f"{len(maps.ids)} objects, {time.perf_counter() - start:.1f} s", err=True)

    namesakes = [name for view in sample.context for name in view.namesakes]
    names, files, panels = map_names([view.name for view in sample.context], namesakes), {}, []
    rows = [("view", "file", "objects", "labelled")]
    with atomic_folder(out) as draft:
        for view, ids, areas in zip(sample.context, maps.labels, maps.areas().T, strict=True):
            suffix, data = encode_ids(ids)
            files[view.name] = names[view.name] + suffix
            file = draft / files[view.name]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
            painted = pictures.paint_labels(ids, view.image)
            panels += [(view.name, view.image), ("objects", painted)]
            labelled = f"{100 * (ids > 0).mean():.1f} %"
            rows.append((view.name, files[view.name], str((areas > 0).sum()), labelled))
        look = pictures.side_by_side(panels)
        (draft / PREVIEW_FILE).write_bytes(pictures.encode_jpeg(look, look.shape[1]))
        identities: dict[str, Any] = {c.kind: {c.name: c.identity()} for c in components}
        identities |= {"replicas": method.replicas, "votes": method.votes}
        text = {"size": list(maps.labels.shape[1:]), "views": files, "settings": identities}
        (draft / MASKS_FILE).write_text(json.dumps(text, indent=1) + "\n", "utf-8")
    typer.echo(table_text(rows, "<<"))
    shared = len(maps.ids) - len(maps.seen_once)
    typer.echo(f"{len(maps.ids)} objects, {shared} of them in several views\n{out}")
