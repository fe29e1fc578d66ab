"""Hand-labelled truth: JSON files as LERF-OVS has them, or the class masks of 3D-OVS.

One file a frame, ``<labels>/<frame>.json``, where frames of one name in several folders lie in such
folders here too::

    {"info": {"name": "frame_00041.jpg", "width": 988, "height": 731},
     "objects": [{"category": "red toaster", "segmentation": [[x, y], ...],
                  "bbox": [x0, y0, x1, y1]}, ...]}

A segmentation is one polygon in pixels. Several objects may share a category; a benchmark sample
is a (frame, category), never an instance, so their masks are united and their boxes kept side by
side. An object may have ``"holes": [[[x, y], ...], ...]``, polygons within its own, which LERF-OVS
does not know: programs that read only its keys see the object filled. Other keys are ignored.

A folder with ``classes.txt`` holds class masks instead (:mod:`slgaussian.benchmark.class_masks`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slgaussian.benchmark import class_masks
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.formats.images import TooLargeError, check_size
from slgaussian.formats.resampling import Window
from slgaussian.io import short_repr
from slgaussian.scene import View


@dataclass(frozen=True, eq=False)
class Truth:
    """What is labelled in the target views of one scene.

    Attributes
    ----------
    masks : {view name: {category: bool [H, W]}}
        A category that was asked for but has no pixel in the frame (not labelled there, or cropped
        away) has an empty mask, so that it is reported and not lost.
    boxes : {view name: {category: float64 [n, 4]}}
        x0, y0, x1, y1 in pixels, one row an object. Empty where the labels have no boxes: they
        follow from the masks.
    """

    masks: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    boxes: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)

    __repr__ = short_repr


def read_labels(
    folder: str | Path, view_name: str, width: int, height: int, shown: Window | None = None
) -> dict[str, np.ndarray]:
    """Read the class masks of one view, bool [height, width] by category.

    Polygons are drawn at the labelled size as LangSplat's evaluation does (points truncated to
    int32, then ``cv2.fillPoly``), and masks brought once to ``width`` x ``height`` by
    :meth:`slgaussian.formats.resampling.Window.mask`: a category that is cropped away has an empty
    one.

    Parameters
    ----------
    shown : Window, optional
        Part of the photograph that the view shows; by default the part that is left when the
        labelled frame is scaled to cover the view and cropped about the centre.

    Raises
    ------
    InputError
        If the labels of the view are missing, damaged, were drawn on another frame or have another
        shape than its photograph.
    """
    if class_masks.are_in(folder):
        return class_masks.read(folder, view_name, width, height, shown)
    return _read_frame(Path(folder), view_name, width, height, shown)[0]


def read_truth(folder: str | Path, categories: Sequence[str], targets: Sequence[View]) -> Truth:
    """Read the masks and boxes of ``categories`` in the target views.

    Raises
    ------
    InputError
        As :func:`read_labels`, for any of the views.
    """
    masks: dict[str, dict[str, np.ndarray]] = {}
    boxes: dict[str, dict[str, np.ndarray]] = {}
    found_boxes: dict[str, np.ndarray] = {}
    dense = class_masks.are_in(folder)
    for view in targets:
        place = view.name, view.camera.width, view.camera.height, view.shown
        if dense:
            found = class_masks.read(folder, *place)
        else:
            found, found_boxes = _read_frame(Path(folder), *place)
        nothing = np.zeros(view.image.shape[:2], bool)
        masks[view.name] = {name: found.get(name, nothing) for name in categories}
        boxes[view.name] = {name: found_boxes.get(name, np.zeros((0, 4))) for name in categories}
    return Truth(masks, {} if dense else boxes)


def boxes_of(mask: np.ndarray, annotated: np.ndarray | None) -> np.ndarray:
    """The annotated boxes [n, 4], or that of the mask if it has a pixel."""
    if annotated is not None:
        return annotated
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    if not len(rows):
        return np.zeros((0, 4))
    return np.array([[columns[0], rows[0], columns[-1], rows[-1]]], np.float64)


def labelled_frames(folder: str | Path) -> dict[str, tuple[str, ...]]:
    """What is labelled in a folder: the categories of each frame, in the order of the frames.

    Frames are named by the path of their labels below the folder, without an extension. Categories
    of class masks are those of ``classes.txt``, whether a frame shows them or not.

    Raises
    ------
    InputError
        If a label file is damaged.
    """
    folder = Path(folder)
    if class_masks.are_in(folder):
        names = class_masks.classes(folder)
        return dict.fromkeys(class_masks.frames(folder), names)
    return {name: _categories(folder / f"{name}.json") for name in frame_names(folder)}


def frame_names(folder: str | Path) -> list[str]:
    """The frames that have labels in a folder, as :func:`labelled_frames` names them."""
    folder = Path(folder)
    if class_masks.are_in(folder):
        return class_masks.frames(folder)
    files = sorted(folder.rglob("*.json"))
    return [file.relative_to(folder).with_suffix("").as_posix() for file in files]


def categories_of(folder: str | Path, view_name: str) -> tuple[str, ...]:
    """What is labelled in one frame, as :func:`labelled_frames` says it of all.

    Raises
    ------
    InputError
        If its label file is missing or damaged.
    """
    if class_masks.are_in(folder):
        return class_masks.classes(folder)
    return _categories(_label_file(Path(folder), view_name))


def label_files(folder: str | Path, view_name: str) -> list[Path]:
    """The files that the labels of a frame are read from; they may not be there."""
    if class_masks.are_in(folder):
        return class_masks.files(folder, view_name)
    return [_label_file(Path(folder), view_name)]


def _label_file(folder: Path, view_name: str) -> Path:
    # Frames of one name in several folders have their labels in such folders.
    nested = folder / Path(view_name).with_suffix(".json")
    return nested if nested.is_file() else folder / f"{Path(view_name).stem}.json"


def _read_frame(
    folder: Path, view_name: str, width: int, height: int, shown: Window | None
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    path = _label_file(folder, view_name)
    name, full_w, full_h, objects = _read_record(path)
    if Path(name).stem != Path(view_name).stem:
        # A labels folder shifted by one frame still scores, only wrongly.
        raise InputError(f"{path}: was drawn on {name!r}, expected labels of {view_name!r}")
    part = shown or Window.covering(full_w, full_h, width, height)
    part.check_shape(path, full_w, full_h)
    drawings: dict[str, list[list[np.ndarray]]] = {}
    boxes: dict[str, list[np.ndarray]] = {}
    for number, entry in enumerate(objects):
        category, polygons, box = _read_object(entry, f"{path}: objects[{number}]")
        drawings.setdefault(category, []).append([p.astype(np.int32) for p in polygons])
        boxes.setdefault(category, []).append(box)
    masks = {}
    for category, outlines in drawings.items():  # one whole frame in memory at a time
        drawn = np.zeros((full_h, full_w), np.uint8)
        for polygons in outlines:
            # Pixels within an even number of the polygons are left as they are.
            cv2.fillPoly(drawn, polygons, 1)
        masks[category] = part.mask(drawn, height, width)
    return masks, {
        name: part.boxes(np.stack(rows), (full_h, full_w), (height, width))
        for name, rows in boxes.items()
    }


def _categories(path: Path) -> tuple[str, ...]:
    objects = _read_record(path)[3]
    found = (_read_object(e, f"{path}: objects[{i}]")[0] for i, e in enumerate(objects))
    return tuple(dict.fromkeys(found))


def _read_record(path: Path) -> tuple[str, int, int, list[Any]]:
    """Name, width and height of the labelled frame, and its objects, not looked at yet."""
    record = _read_json(path)
    try:
        info, objects = record["info"], list(record["objects"])
        name, full_w, full_h = str(info["name"]), int(info["width"]), int(info["height"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: expected info.name, info.width, info.height and objects, but {_reason(error)}"
        ) from error
    if full_w < 1 or full_h < 1:
        raise InputError(f"{path}: info has size {full_w}x{full_h}, expected at least 1x1")
    try:
        check_size(full_w, full_h)
    except TooLargeError as bad:
        raise InputError(f"{path}: info: {bad}, and draw the labels anew") from None
    return name, full_w, full_h, objects


def _read_object(entry: Any, where: str) -> tuple[str, list[np.ndarray], np.ndarray]:
    """Category, polygon and its holes, box."""
    try:
        category = entry["category"]
        polygons = [
            np.array(p, np.float64) for p in (entry["segmentation"], *entry.get("holes", ()))
        ]
        box = np.array(entry["bbox"], np.float64).reshape(2, 2)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{where}: expected category, segmentation [[x, y], ...] and bbox [x0, y0, x1, y1], "
            f"but {_reason(error)}"
        ) from error
    if not isinstance(category, str) or not category.strip():
        raise InputError(f"{where}: category is {category!r}, expected a word or phrase")
    for polygon in polygons:
        if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
            raise InputError(
                f"{where}: segmentation or a hole has shape {polygon.shape}, expected one polygon "
                "of three or more [x, y] points"
            )
        if not (np.abs(polygon) < 1e6).all() or not (np.abs(box) < 1e6).all():
            raise InputError(
                f"{where}: segmentation or bbox holds NaN or a coordinate that no image has"
            )
    # Two corners in any order.
    return category, polygons, np.concatenate([box.min(0), box.max(0)])


def _read_json(path: Path) -> Any:
    try:
        return strict_json.parse(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot read the label file ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: the label file is not valid JSON ({error})") from error


def _reason(error: Exception) -> str:
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)
