"""Draw fields and other Gaussians."""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flows.cli.drawings import check_drawing, drawing
from flows.cli.viewpoints import Choice, Viewpoint
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.labels import VISIBLE
from slgaussian.storage.account import Account

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians

Panels = tuple[np.ndarray, np.ndarray, list[tuple[str, np.ndarray]]]
"""A picture uint8 [H, W, 3], z-depth float [H, W], and further pictures with captions."""


def draw(source: Path, choice: Choice, out: Path, stats: bool = False) -> None:
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
        account = account_lines(field)
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
    with drawing(out, choice.film) as write:
        for viewpoint in viewpoints:
            rgb, depth, others = look(viewpoint)
            # One scale for all frames, so that a film does not flicker.
            depths = depths or pictures.depth_range(depth)
            panels = [(viewpoint.caption, rgb), ("depth", pictures.paint_depth(depth, *depths))]
            write(pictures.side_by_side([*panels, *others]))
            drawn += 1
    if stats:
        spent = time.perf_counter() - opened
        took = f"seconds: {opened - begun:.2f} to open, {spent / drawn:.2f} a picture"
        print("\n".join([*account, took]))


def account_lines(field: SemanticField) -> list[str]:
    """Describe what a field is made of, in lines for people."""
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
