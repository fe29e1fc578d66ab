"""What the commands about a single field do: build, ask, render, export."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.settings import make_settings
from slgaussian import datasets, harmonics
from slgaussian.benchmark import pictures
from slgaussian.build import build_field
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField, check_target
from slgaussian.ply import load_ply, save_ply
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera, Scene
from slgaussian.semantic.decode import VISIBLE
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
    parts = ", ".join(method.part_names().values())
    print(
        f"building a field from {len(names)} views of {width}x{height} with {parts}",
        file=sys.stderr,
    )
    field = build_field(sample, **method.build_arguments())
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


def picture(source: Path, cameras: Path | None, view: str, out: Path) -> None:
    """Draw colour and depth of a field or a ``.ply`` side by side, and the objects of a field.

    A field is seen from one of its own cameras, unless ``cameras`` is given; a ``.ply`` has none.
    """
    if source.suffix.lower() != ".ply" or source.is_dir():
        name, seen = _look(source, view, cameras)
        panels = [(name, seen.rgb), _depth_panel(seen.depth)]
        panels.append(("objects", pictures.paint_labels(seen.ids, seen.rgb)))
    else:
        if cameras is None:
            raise InputError(
                f"{source}: a .ply has no cameras; add --cameras transforms.json, in the world of "
                "the .ply, and --view with the name of one of its frames"
            )
        scene = datasets.load("nerfstudio", cameras)
        name = _choose(scene, view)
        panels = _ply_panels(source, name, scene.cameras[name])
    _write_png(out, pictures.side_by_side(panels))


def to_ply(folder: Path, out: Path) -> None:
    """Write a field as a standard ``.ply``: its Gaussians, their codes and their objects."""
    field = SemanticField.load(folder)
    save_ply(field.gaussians, out, field.labels())


def _ply_panels(file: Path, name: str, camera: Camera) -> list[tuple[str, np.ndarray]]:
    gaussians, _ = load_ply(file)
    if not len(gaussians):
        raise InputError(f"{file}: holds no Gaussians, so there is nothing to draw")
    seen = rasterize(gaussians, harmonics.colors(gaussians, camera), camera)
    alpha = seen.alpha.numpy()
    if not (alpha >= VISIBLE).any():
        middle = ", ".join(f"{x:.3g}" for x in gaussians.means.median(0).values.tolist())
        print(
            f"hardly anything of {file} is in view of {name!r}: the middle of its "
            f"{len(gaussians)} Gaussians is at ({middle}), the camera at "
            f"({', '.join(f'{x:.3g}' for x in camera.center)}); do both use one world?",
            file=sys.stderr,
        )
    # Over black, as such files are trained; where little is seen, its mean depth says nothing.
    rgb = np.rint(seen.values.numpy().clip(0, 1) * 255).astype(np.uint8)
    return [(name, rgb), _depth_panel(np.where(alpha >= VISIBLE, seen.depth.numpy(), 0))]


def _depth_panel(depth: np.ndarray) -> tuple[str, np.ndarray]:
    return "depth", pictures.paint_depth(depth, *pictures.depth_range(depth))


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


def _look(folder: Path, view: str, cameras: Path | None = None) -> tuple[str, FieldView]:
    field = SemanticField.load(folder)
    if cameras is None:
        # A scene without photographs: only to find names the one way that names are found.
        scene = Scene(str(folder), field.cameras, read=_unreadable)
    else:
        scene = datasets.load("nerfstudio", cameras)
    name = _choose(scene, view)
    return name, field.render(scene.cameras[name])


def _choose(scene: Scene, view: str) -> str:
    """The name of the view called ``view``, or of that number."""
    names = list(scene.cameras)
    if view.isdecimal() and str(int(view)) == view and int(view) < len(names):
        return names[int(view)]
    return scene.find(view)


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
