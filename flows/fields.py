"""What the commands about a single field do: build, ask, render, export."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flows.settings import TABLES, make_settings
from slgaussian import datasets, harmonics
from slgaussian.benchmark import pictures
from slgaussian.build import build_field
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField
from slgaussian.field_folder import check_target
from slgaussian.language.query import QueryResult, Rules
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
    texts: Sequence[str],
    views: Sequence[str],
    out: Path | None,
    settings: Mapping[str, Any],
) -> list[dict[str, Any]]:
    """Ask the field in ``folder`` and draw the answers to ``out``, if given.

    ``settings`` are those of :class:`slgaussian.language.query.Rules`, and by the name of the
    field's encoder a table that says where its files are now.

    Returns
    -------
    list of dict
        One a view and text: ``text``, ``view``, ``score``, ``point`` [x, y] or None, ``objects``
        (``id``, ``relevancy``), ``pixels`` in the mask, ``unknown`` words, those ``taken_for``
        others (word: [other, similarity]), ``picture`` path or None.
    """
    rules, field = _opened(folder, settings)
    names = [_choose(_scene_of(folder, field), view) for view in views]
    answers, panels = [], []
    for name in names:
        seen = field.render(field.cameras[name])
        for hit in seen.query_all(texts, **rules):
            answers.append(
                {
                    "text": hit.text,
                    "view": name,
                    "score": hit.score,
                    "point": None if hit.point is None else list(hit.point),
                    "objects": [{"id": id_, "relevancy": score} for id_, score in hit.objects],
                    "pixels": int(hit.mask.sum()),
                    "unknown": list(hit.unknown),
                    "taken_for": {word: list(other) for word, other in hit.taken_for.items()},
                    "picture": None if out is None else str(out),
                }
            )
            if out is not None:
                panels.append(_hit_panels(name, seen, hit))
    if out is not None:
        _write_png(out, np.concatenate([pictures.side_by_side(row) for row in panels]))
    return answers


def inventory(
    folder: Path, texts: Sequence[str], out: Path | None, settings: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Every object of a field with the best of the texts; what they look like in ``out``, if given.

    ``settings`` as in :func:`ask`.

    Returns
    -------
    list of dict
        One an object: ``id``, ``text``, ``relevancy``, ``views`` that hold it by name.
    """
    rules, field = _opened(folder, settings)
    found = field.describe(texts, **rules)
    names = list(field.cameras)
    if out is not None:
        if field.bank.boxes is None:
            raise InputError(
                f"{folder}: its memory bank does not know where the objects are, so they cannot be "
                "drawn; leave out -o, or build the field again"
            )
        seen = [field.render(camera) for camera in field.cameras.values()]
        cuts = pictures.cut_out(
            [view.rgb for view in seen],
            [view.ids for view in seen],
            field.bank.ids,
            field.bank.boxes,
        )
        captions = [f"{one.id} {one.text}" if one.relevancy > 0.5 else str(one.id) for one in found]
        tiles = list(zip(captions, cuts, strict=True))
        _write_png(out, pictures.contact_sheet(tiles, side=112, columns=8))
    return [{**vars(one), "views": [names[view] for view in one.views]} for one in found]


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


def _opened(folder: Path, settings: Mapping[str, Any]) -> tuple[dict[str, Any], SemanticField]:
    """The rules among the settings, and the field, with its encoder ready to be asked."""
    rules = {name: value for name, value in settings.items() if name not in TABLES}
    Rules(**rules)
    field = SemanticField.load(folder)
    used = field.settings["encoder"]
    where = {part: table for part, table in settings.items() if part in TABLES}
    for part in where:
        if part != used:
            raise InputError(
                f"{folder}: settings of {part!r} are given, but the field's encoder is {used!r}; "
                "leave them out"
            )
    field = replace(field, places={**field.places, **where.get(used, {})})
    field.encoder  # noqa: B018  (what is missing is said before anything is drawn)
    return rules, field


def _look(folder: Path, view: str, cameras: Path | None = None) -> tuple[str, FieldView]:
    field = SemanticField.load(folder)
    known = cameras is None
    scene = _scene_of(folder, field) if known else datasets.load("nerfstudio", cameras)
    name = _choose(scene, view)
    return name, field.render(scene.cameras[name])


def _scene_of(folder: Path, field: SemanticField) -> Scene:
    """A scene without photographs: only to find names the one way that names are found."""
    return Scene(str(folder), field.cameras, read=_unreadable)


def _hit_panels(name: str, seen: FieldView, hit: QueryResult) -> list[tuple[str, np.ndarray]]:
    where = pictures.draw_outline(seen.rgb, hit.mask, pictures.PREDICTED)
    return [
        (name, seen.rgb),
        (f"relevancy of {hit.text!r}", pictures.paint_relevancy(hit.relevancy, seen.rgb)),
        (f"score {hit.score:.3f}", pictures.draw_point(where, hit.point)),
    ]


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
