"""Hand-labelled truth: the LERF-OVS JSON files and the index of scene pairs.

One file a frame, ``<labels>/<frame>.json``::

    {"info": {"name": "frame_00041.jpg", "width": 988, "height": 731},
     "objects": [{"category": "red toaster", "segmentation": [[x, y], ...],
                  "bbox": [x0, y0, x1, y1]}, ...]}

A segmentation is one polygon in pixels. Several objects may share a category; a benchmark sample
is a (frame, category), never an instance, so their masks are united and their boxes kept side by
side. Other keys are ignored.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import View


@dataclass(frozen=True)
class ScenePair:
    """Two context frames, the held-out frames between them, and what is asked there."""

    scene: str
    context: tuple[str, ...]
    targets: tuple[str, ...]
    categories: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Truth:
    """What is labelled in the target views of one scene.

    Attributes
    ----------
    masks : {view name: {category: bool [H, W]}}
        A category that was asked for but has no pixel in the frame (not labelled there, or cropped
        away) has an empty mask, so that it is reported and not lost.
    boxes : {view name: {category: float64 [n, 4]}}
        x0, y0, x1, y1 in pixels, one row an object.
    """

    masks: dict[str, dict[str, np.ndarray]]
    boxes: dict[str, dict[str, np.ndarray]]


def read_labels(
    folder: str | Path, view_name: str, width: int, height: int
) -> dict[str, np.ndarray]:
    """Read the class masks of one frame, bool [height, width] by category.

    Masks are drawn at the labelled size as LangSplat's evaluation does (points truncated to int32,
    then ``cv2.fillPoly``), then brought to ``width`` x ``height`` the way
    :meth:`slgaussian.scene.View.resized` brings an image there: scaled to cover, centre-cropped,
    nearest pixel. A category that is cropped away keeps its (empty) mask.

    Raises
    ------
    InputError
        If ``<folder>/<stem of view_name>.json`` is missing, is not such a file, or was drawn on
        another frame.
    """
    return _read_frame(folder, view_name, width, height)[0]


def read_truth(folder: str | Path, pair: ScenePair, targets: Sequence[View]) -> Truth:
    """Read the masks and boxes of the categories of ``pair`` in its target views.

    Raises
    ------
    InputError
        As :func:`read_labels`, for any of the views.
    """
    masks: dict[str, dict[str, np.ndarray]] = {}
    boxes: dict[str, dict[str, np.ndarray]] = {}
    for view in targets:
        width, height = view.camera.width, view.camera.height
        found, found_boxes = _read_frame(folder, view.name, width, height)
        nothing = np.zeros((height, width), bool)
        masks[view.name] = {name: found.get(name, nothing) for name in pair.categories}
        boxes[view.name] = {
            name: found_boxes.get(name, np.zeros((0, 4))) for name in pair.categories
        }
    return Truth(masks, boxes)


def read_pairs(path: str | Path) -> list[ScenePair]:
    """Read ``{scene: {"context": [...], "target": [...], "categories": [...]}}``, in file order.

    Raises
    ------
    InputError
        If the file is missing or malformed, a target is also a context frame, or a list is too
        short or repeats an entry.
    """
    path = Path(path)
    index = _read_json(path, "pair index")
    if not isinstance(index, dict) or not index:
        raise InputError(f"{path}: expected an object of scenes, found {_kind(index)}")
    pairs = []
    for scene, entry in index.items():
        where = f"{path}: scene {scene!r}"
        if not isinstance(entry, dict):
            raise InputError(f"{where}: expected an object, found {_kind(entry)}")
        context = _names(entry, "context", 2, where)
        targets = _names(entry, "target", 1, where)
        categories = _names(entry, "categories", 1, where)
        seen = sorted(set(context) & set(targets))
        if seen:
            raise InputError(
                f"{where}: {seen[0]!r} is both context and target; a target must be held out"
            )
        pairs.append(ScenePair(scene, context, targets, categories))
    return pairs


def _read_frame(
    folder: str | Path, view_name: str, width: int, height: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    stem = Path(view_name).stem
    path = Path(folder) / f"{stem}.json"
    record = _read_json(path, "label file")
    try:
        info, objects = record["info"], list(record["objects"])
        name, full_w, full_h = str(info["name"]), int(info["width"]), int(info["height"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: expected info.name, info.width, info.height and objects, but {_reason(error)}"
        ) from error
    if Path(name).stem != stem:
        # A labels folder shifted by one frame still scores, only wrongly.
        raise InputError(f"{path}: was drawn on {name!r}, expected labels of {view_name!r}")
    if full_w < 1 or full_h < 1:
        raise InputError(f"{path}: info has size {full_w}x{full_h}, expected at least 1x1")
    masks: dict[str, np.ndarray] = {}
    boxes: dict[str, list[np.ndarray]] = {}
    for number, entry in enumerate(objects):
        category, polygon, box = _read_object(entry, f"{path}: objects[{number}]")
        drawn = masks.setdefault(category, np.zeros((full_h, full_w), np.uint8))
        cv2.fillPoly(drawn, [polygon.astype(np.int32)], 1)
        boxes.setdefault(category, []).append(box)
    at = _placement(full_w, full_h, width, height)
    window = np.s_[at.top : at.top + height, at.left : at.left + width]
    stretch = np.array([at.wide / full_w, at.high / full_h] * 2)
    return (
        {
            name: cv2.resize(drawn, (at.wide, at.high), interpolation=cv2.INTER_NEAREST)[window] > 0
            for name, drawn in masks.items()
        },
        {
            name: np.stack(rows) * stretch - [at.left, at.top, at.left, at.top]
            for name, rows in boxes.items()
        },
    )


def _read_object(entry: Any, where: str) -> tuple[str, np.ndarray, np.ndarray]:
    try:
        category = entry["category"]
        polygon = np.array(entry["segmentation"], np.float64)
        box = np.array(entry["bbox"], np.float64).reshape(2, 2)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{where}: expected category, segmentation [[x, y], ...] and bbox [x0, y0, x1, y1], "
            f"but {_reason(error)}"
        ) from error
    if not isinstance(category, str) or not category.strip():
        raise InputError(f"{where}: category is {category!r}, expected a word or phrase")
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise InputError(
            f"{where}: segmentation has shape {polygon.shape}, expected one polygon of three or "
            "more [x, y] points"
        )
    if not ((np.abs(polygon) < 1e6).all() and (np.abs(box) < 1e6).all()):
        raise InputError(
            f"{where}: segmentation or bbox holds NaN or a coordinate that no image has"
        )
    # Two corners in any order.
    return category, polygon, np.concatenate([box.min(0), box.max(0)])


@dataclass(frozen=True)
class _Placement:
    """Where a labelled frame lands when it is scaled to cover an image and centre-cropped."""

    wide: int
    high: int
    left: int
    top: int


def _placement(full_w: int, full_h: int, width: int, height: int) -> _Placement:
    scale = max(height / full_h, width / full_w)
    wide, high = max(width, round(full_w * scale)), max(height, round(full_h * scale))
    return _Placement(wide, high, (wide - width) // 2, (high - height) // 2)


def _names(entry: dict[str, Any], key: str, at_least: int, where: str) -> tuple[str, ...]:
    names = entry.get(key)
    if not isinstance(names, list) or not all(isinstance(n, str) and n.strip() for n in names):
        raise InputError(f"{where}: {key!r} is {_kind(names)}, expected a list of names")
    if len(names) < at_least or len(set(names)) < len(names):
        raise InputError(
            f"{where}: {key!r} holds {names}, expected at least {at_least} different name(s)"
        )
    return tuple(names)


def _read_json(path: Path, what: str) -> Any:
    try:
        return json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the {what} ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: the {what} is not valid JSON ({error})") from error


def _reason(error: Exception) -> str:
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


def _kind(value: Any) -> str:
    return "missing" if value is None else f"a {type(value).__name__}"
