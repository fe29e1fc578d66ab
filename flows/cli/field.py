"""What the commands about a single field do beside asking it: build, render, export."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flows.cli.drawings import check_drawing, drawing
from flows.cli.posing import posed_sample
from flows.cli.viewpoints import Choice, Viewpoint
from flows.settings import make_settings
from slgaussian import ahead
from slgaussian.build import build_field
from slgaussian.cameras.quality import Quality
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.labels import VISIBLE
from slgaussian.parts.method import Method
from slgaussian.scene import Sample
from slgaussian.storage.account import Account
from slgaussian.storage.field_folder import check_target
from slgaussian.storage.inputs import describe_photographs
from slgaussian.things import COMMON_THINGS

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians

Panels = tuple[np.ndarray, np.ndarray, list[tuple[str, np.ndarray]]]
"""A picture uint8 [H, W, 3], z-depth float [H, W], and further pictures with captions."""


def build(
    photos: Sequence[str],
    cameras: Path | None,
    refine: bool,
    keyframes: int | None,
    out: Path,
    options: dict[str, Any],
) -> Path:
    """Build a field from photographs and save it to folder ``out``.

    Photographs, cameras and keyframes are as :func:`flows.cli.posing.posed_sample` takes them.

    Raises
    ------
    InputError
        If anything given cannot be used; a folder that cannot be written is found before the work.
    """
    settings = make_settings(options, "field")
    check_target(out)
    start = time.perf_counter()
    sample, places = posed_sample(photos, cameras, refine, settings, keyframes)
    seconds = {"cameras" if cameras is None else "reading": time.perf_counter() - start}
    field = _built(sample, settings.built_by, settings.trust_cameras, seconds)
    field.save(out, describe_photographs(places))
    _report(field, out, seconds, time.perf_counter() - start)
    return out


def _built(
    sample: Sample, method: Method, trusted: bool, seconds: dict[str, float]
) -> SemanticField:
    """Build the field of a sample; the seconds of each step are added to ``seconds``."""
    ahead.begin()
    height, width = sample.context[0].image.shape[:2]
    parts = ", ".join(part.name for part in method.parts)
    print(
        f"building a field from {len(sample.context)} views of {width}x{height} with {parts}",
        file=sys.stderr,
    )
    return build_field(sample, method, trusted, seconds.__setitem__)


def _report(field: SemanticField, out: Path, seconds: dict[str, float], whole: float) -> None:
    """Print what a field is, how good it is, what it took, and what to do with it."""
    size = f"{len(field.gaussians)} Gaussians, {len(field.bank)} objects"
    print(f"{size}, {whole:.1f} s", file=sys.stderr)
    quality = Quality(**field.settings["quality"])
    for warning in quality.warnings():
        print(f"warning: {warning}", file=sys.stderr)
    print(quality.summary(), file=sys.stderr)
    spent = ", ".join(f"{step} {taken:.2f}" for step, taken in seconds.items())
    for line in (*_account(field), f"seconds: {spent}"):
        print(line, file=sys.stderr)
    word = _answered(field)
    if word is not None:
        command = ["slgaussian", "query", str(out), word, "-o", "hit.png"]
        print(f"ask it: {shlex.join(command)}", file=sys.stderr)
    print(f"look at it: {shlex.join(['slgaussian', 'view', str(out)])}", file=sys.stderr)


def picture(source: Path, choice: Choice, out: Path, stats: bool = False) -> None:
    """Draw colour and depth of a field or a ``.ply`` side by side, and the objects of a field.

    A field is seen from one of its own cameras, unless ``choice`` names a camera file; a ``.ply``
    has none. With ``stats`` the account of the field is printed, and how long this took.
    """
    from slgaussian.benchmark import pictures
    from slgaussian.formats.ply import load_ply

    begun = time.perf_counter()
    check_drawing(out, choice.film)
    if source.suffix.lower() != ".ply" or source.is_dir():
        field = SemanticField.load(source)
        account = _account(field)
        viewpoints, look = choice.of_field(source, field), partial(_field_panels, field)
    else:
        if choice.file is None:
            raise InputError(
                f"{source}: a .ply has no cameras; add --camera transforms.json, in the world of "
                "the .ply, and --view with the name of one of its frames"
            )
        gaussians, _ = load_ply(source)
        if not len(gaussians):
            raise InputError(f"{source}: holds no Gaussians, so there is nothing to draw")
        account = [f"Gaussians: {len(gaussians):,}"]
        viewpoints = choice.of_points(gaussians.to_arrays()["means"])
        look = partial(_ply_panels, gaussians, source)
    opened, drawn, depths = time.perf_counter(), 0, None
    with drawing(out, choice.film) as draw:
        for viewpoint in viewpoints:
            rgb, depth, others = look(viewpoint)
            # One scale for all frames, so that a film does not flicker.
            depths = depths or pictures.depth_range(depth)
            panels = [(viewpoint.caption, rgb), ("depth", pictures.paint_depth(depth, *depths))]
            draw(pictures.side_by_side([*panels, *others]))
            drawn += 1
    if stats:
        spent = time.perf_counter() - opened
        took = f"seconds: {opened - begun:.2f} to open, {spent / drawn:.2f} a picture"
        print("\n".join([*account, took]))


def _account(field: SemanticField) -> list[str]:
    """What a field is made of, in lines for people."""
    account = Account.of(field.settings)
    held = f"{len(field.gaussians):,} Gaussians, {len(field.bank):,} objects"
    return [held] if account is None else account.lines()


def _field_panels(field: SemanticField, viewpoint: Viewpoint) -> Panels:
    from slgaussian.benchmark import pictures

    seen = field.render(viewpoint.camera)
    return seen.rgb, seen.depth, [("objects", pictures.paint_labels(seen.ids, seen.rgb))]


def _ply_panels(gaussians: Gaussians, file: Path, viewpoint: Viewpoint) -> Panels:
    from slgaussian.rasterize.picture import picture as drawn
    from slgaussian.rasterize.picture import seen_colors

    camera = viewpoint.camera
    seen = drawn(gaussians, seen_colors(gaussians, camera), camera)
    alpha = seen.alpha
    if not (alpha >= VISIBLE).any():
        middle = ", ".join(f"{x:.3g}" for x in gaussians.means.median(0).values.tolist())
        print(
            f"hardly anything of {file} is in view of {viewpoint.name!r}: the middle of its "
            f"{len(gaussians)} Gaussians is at ({middle}), the camera at "
            f"({', '.join(f'{x:.3g}' for x in camera.center)}); do both use one world?",
            file=sys.stderr,
        )
    # Over black, as such files are trained; where little is seen, its mean depth says nothing.
    rgb = np.rint(seen.values.clip(0, 1) * 255).astype(np.uint8)
    return rgb, np.where(alpha >= VISIBLE, seen.depth, 0), []


def _answered(field: SemanticField) -> str | None:
    """Choose the common thing that a query finds most surely in the first view; None if none is."""
    if field.settings["encoder"] != "lexicon":  # nobody measured how sure others are
        return None
    view = field.render(next(iter(field.cameras.values())))
    sure = {
        hit.text: hit.confidence.mask
        for hit in view.query_all(COMMON_THINGS)
        if hit.found and hit.confidence is not None
    }
    return max(sure, key=sure.__getitem__, default=None)
