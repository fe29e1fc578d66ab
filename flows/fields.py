"""What the commands about a single field do: build, ask, render, export."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.settings import make_settings
from slgaussian import datasets
from slgaussian.benchmark import pictures
from slgaussian.build import build_field
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField, check_target
from slgaussian.gaussians import save_ply
from slgaussian.scene import Scene
from slgaussian.store import write_atomic


def build(photos: Sequence[str], cameras: Path, out: Path, options: dict[str, Any]) -> Path:
    """Build a field from photographs and save it to folder ``out``.

    A photograph is a file that the camera file lists, or the name of one of its views.

    Raises
    ------
    InputError
        If anything given cannot be used; a folder that cannot be written is found before the work.
    """
    method = make_settings(options, "field")
    check_target(out)
    scene = datasets.load("nerfstudio", cameras)
    folder = cameras if cameras.is_dir() else cameras.parent
    names = [_view_of(scene, photo, folder) for photo in photos]
    start = time.perf_counter()
    sample = scene.sample(names, size=method.size, near=method.near, far=method.far)
    height, width = sample.context[0].image.shape[:2]
    print(f"building a field from {len(names)} views of {width}x{height}", file=sys.stderr)
    field = build_field(sample, **method.parts())
    field.save(out)
    found = f"{len(field.gaussians)} Gaussians, {len(field.bank)} objects"
    print(f"{found}, {time.perf_counter() - start:.1f} s", file=sys.stderr)
    return out


def ask(
    folder: Path,
    text: str,
    view: str,
    out: Path | None,
    temperature: float,
    threshold: float | None,
) -> dict[str, Any]:
    """Ask the field in ``folder`` and draw the answer to ``out``, if given.

    Returns
    -------
    dict
        ``text``, ``view``, ``score``, ``point`` [x, y] or None, ``objects`` (``id``,
        ``relevancy``), ``pixels`` in the mask, ``unknown`` words, ``picture`` path or None.
    """
    name, seen = _look(folder, view)
    hit = seen.query(text, threshold=threshold, temperature=temperature)
    if out is not None:
        where = pictures.draw_outline(seen.rgb, hit.mask, pictures.PREDICTED)
        panels = [
            (name, seen.rgb),
            (f"relevancy of {text!r}", pictures.paint_relevancy(hit.relevancy, seen.rgb)),
            (f"score {hit.score:.3f}", pictures.draw_point(where, hit.point)),
        ]
        _write_png(out, pictures.side_by_side(panels))
    return {
        "text": text,
        "view": name,
        "score": hit.score,
        "point": None if hit.point is None else list(hit.point),
        "objects": [{"id": id_, "relevancy": relevancy} for id_, relevancy in hit.objects],
        "pixels": int(hit.mask.sum()),
        "unknown": list(hit.unknown),
        "picture": None if out is None else str(out),
    }


def picture(folder: Path, view: str, out: Path) -> None:
    """Draw colour, depth and objects of a field side by side."""
    name, seen = _look(folder, view)
    depth = pictures.paint_depth(seen.depth, *pictures.depth_range(seen.depth))
    objects = pictures.paint_labels(seen.ids, seen.rgb)
    _write_png(
        out, pictures.side_by_side([(name, seen.rgb), ("depth", depth), ("objects", objects)])
    )


def to_ply(folder: Path, out: Path) -> None:
    """Write the Gaussians of a field as a standard ``.ply``."""
    field = SemanticField.load(folder)
    try:
        # Beside the target, so that what cannot be moved there is found before the work.
        with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as draft:
            save_ply(field.gaussians, Path(draft, out.name))
            os.replace(Path(draft, out.name), out)
    except OSError as error:
        raise _unwritable(out, error) from error


def _view_of(scene: Scene, photo: str, folder: Path) -> str:
    place = Path(photo).resolve()
    for name in scene.cameras:
        listed = (folder / name).resolve()
        # A missing file is found too, and reading it then says what is missing.
        if listed in (place, place.with_suffix("")):
            return name
    if Path(photo).is_file():
        raise InputError(
            f"{photo}: no camera for this photograph; {folder} has cameras for "
            f"{len(scene.cameras)}, such as {', '.join(list(scene.cameras)[:4])}: give one of "
            "them, or add a camera"
        )
    return scene.find(photo)


def _look(folder: Path, view: str) -> tuple[str, FieldView]:
    field = SemanticField.load(folder)
    names = list(field.cameras)
    if view.isdecimal() and str(int(view)) == view and int(view) < len(names):
        name = names[int(view)]
    else:
        # A scene without photographs: only to find names the one way that names are found.
        name = Scene(str(folder), field.cameras, read=_unreadable).find(view)
    return name, field.render(field.cameras[name])


def _unreadable(name: str) -> Any:
    raise InputError(f"{name}: a field holds no photographs")


def _write_png(path: Path, image: np.ndarray) -> None:
    try:
        write_atomic(path, pictures.encode_png(image))
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(
        f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists and "
        "that you may write to"
    )
