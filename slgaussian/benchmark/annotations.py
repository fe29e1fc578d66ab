"""Reading of hand-labelled ground truth: JSON of LERF-OVS or COCO, or the class masks of 3D-OVS.

There is one file per frame, ``<labels>/<frame>.json``, also in subfolders as the frames::

    {"info": {"name": "frame_00041.jpg", "width": 988, "height": 731},
     "objects": [{"category": "red toaster", "segmentation": [[x, y], ...],
                  "bbox": [x0, y0, x1, y1]}, ...]}

A segmentation is one polygon in pixels. Masks of objects of one category are united, and their
boxes are listed. An object may have ``"holes": [[[x, y], ...], ...]``, polygons inside its own,
which LERF-OVS does not have. Other keys are ignored. Polygons are compared with the size, and boxes
with polygons: COCO's x, y, width, height is recognised by that.

A folder with ``classes.txt`` contains class masks, ``<frame>/<class>.png`` for every class; a line
of the file is a class and its query text. Folders have the names of photographs, as in the
published scenes; 3D-OVS uses them as indices into the sorted photographs.

A COCO file, or a folder with one, has the labels of all frames
(:mod:`slgaussian.benchmark.coco_labels`).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, PositiveInt

from slgaussian.benchmark import coco_labels
from slgaussian.checks import companion, match_rank, name_parts
from slgaussian.errors import InputError
from slgaussian.formats.coco import find_coco
from slgaussian.formats.documents import check_document, read_json
from slgaussian.formats.images import TooLargeError, check_size, read_mask
from slgaussian.formats.resampling import Window
from slgaussian.io import read_lines, short_repr
from slgaussian.scene import View

CLASSES_FILE = "classes.txt"

MASK_GREY = 255
"""Grey level of a class mask; 3D-OVS takes all others, blurred edges too, for background."""

OUTSIDE = 0.05
"""Share of the picture by which a polygon may pass its border."""

BOX_SLACK, BOX_SHARE = 2.0, 0.02
"""Pixels, and share of its longer side in addition, by which a box may differ from its polygon."""

MIN_BOX_OVERLAP = 0.5
"""IoU with its polygon's box of a box that was drawn loosely, by hand."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Labels of the target views of one scene, by view name and category.

    Attributes:
        masks: bool [H, W]; empty masks of categories that are not labelled in the frame, or cropped
            away, so that they are reported.
        boxes: float64 [n, 4], x0, y0, x1, y1 in pixels, a row per object. Empty if the labels have
            no boxes, which are then computed from the masks.
        opaque: bool [H, W] of each view with transparent pixels, whose truth is unknown.
    """

    masks: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    boxes: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    opaque: Mapping[str, np.ndarray] = field(default_factory=dict)

    __repr__ = short_repr


def read_labels(
    folder: str | Path, view_name: str, width: int, height: int, window: Window | None = None
) -> dict[str, np.ndarray]:
    """Read the class masks of one view, bool [height, width] by category.

    Polygons are drawn at the labelled size as LangSplat's evaluation does (points truncated to
    int32, then ``cv2.fillPoly``), then resampled. ``window`` is the part of the photograph that the
    view shows; by default the labelled frame is scaled to cover the view and cropped about the
    centre.

    Raises:
        InputError: If the labels of the view are missing, damaged, belong to another frame or have
            another aspect ratio than its photograph.
    """
    return _read_frame(Path(folder), view_name, (), width, height, window)[0]


def read_truth(folder: str | Path, categories: Sequence[str], targets: Sequence[View]) -> Truth:
    """Read the masks and boxes of ``categories`` in the target views.

    Raises:
        InputError: As :func:`read_labels`, for any of the views.
    """
    masks: dict[str, dict[str, np.ndarray]] = {}
    boxes: dict[str, dict[str, np.ndarray]] = {}
    for view in targets:
        size = view.camera.width, view.camera.height
        drawn, corners = _read_frame(
            Path(folder), view.name, view.namesakes, *size, view.visible_window
        )
        nothing = np.zeros(view.image.shape[:2], bool)
        if view.opaque is not None:
            drawn = {name: mask & view.opaque for name, mask in drawn.items()}
        masks[view.name] = {name: drawn.get(name, nothing) for name in categories}
        if corners is not None:
            none = np.zeros((0, 4))
            boxes[view.name] = {name: corners.get(name, none) for name in categories}
    opaque = {view.name: view.opaque for view in targets if view.opaque is not None}
    return Truth(masks, boxes, opaque)


def find_boxes(mask: np.ndarray, annotated: np.ndarray | None) -> np.ndarray:
    """Return the annotated boxes [n, 4], or the bounding box of a mask that is not empty."""
    if annotated is not None:
        return annotated
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    if not len(rows):
        return np.zeros((0, 4))
    return np.array([[columns[0], rows[0], columns[-1], rows[-1]]], np.float64)


def labelled_frames(folder: str | Path) -> dict[str, tuple[str, ...]]:
    """List the labelled categories of each frame in a folder, in the order of the frames.

    Frames are named by the path of their labels below the folder, without an extension.

    Raises:
        InputError: If a label file is damaged.
    """
    folder = Path(folder)
    if (folder / CLASSES_FILE).is_file():
        frames = sorted(path.name for path in folder.iterdir() if path.is_dir())
        return dict.fromkeys(frames, _classes(folder))
    if (file := find_coco(folder)) is not None:
        return coco_labels.list_frames(folder, file)
    return {
        file.relative_to(folder).with_suffix("").as_posix(): _read_record(file).categories
        for file in sorted(folder.rglob("*.json"))
    }


def label_files(folder: str | Path, view_name: str, namesakes: Sequence[str] = ()) -> list[Path]:
    """Return the files from which the labels of a frame are read; they may be missing.

    Raises:
        InputError: If they fit one of the ``namesakes`` too, the photographs with its file name.
    """
    folder, stem = Path(folder), name_parts(view_name)[-1]
    if (folder / CLASSES_FILE).is_file():
        masks = companion(folder, view_name, [""], namesakes) or folder / stem
        return [folder / CLASSES_FILE, *(masks / f"{name}.png" for name in _classes(folder))]
    return [_find_json(folder, view_name, namesakes)[0]]


def _find_json(folder: Path, view_name: str, namesakes: Sequence[str]) -> tuple[Path, bool]:
    """Return the JSON file with the labels of a frame, and whether it is COCO's."""
    file = companion(folder, view_name, [".json"], namesakes)
    coco = find_coco(folder) if file is None else None
    return file or coco or folder / f"{name_parts(view_name)[-1]}.json", coco is not None


def _read_frame(
    folder: Path,
    view_name: str,
    namesakes: Sequence[str],
    width: int,
    height: int,
    window: Window | None,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray] | None]:
    """Read masks and boxes of a frame; class masks have no boxes."""
    if (folder / CLASSES_FILE).is_file():
        files = label_files(folder, view_name, namesakes)[1:]
        return _read_class_masks(folder, files, width, height, window), None
    path, is_coco = _find_json(folder, view_name, namesakes)
    if is_coco:
        return coco_labels.read_frame(path, view_name, namesakes, width, height, window)
    record = _read_record(path)
    name, full_w, full_h = record.info.name, record.info.width, record.info.height
    rank = match_rank(name, view_name)
    if not rank or any(match_rank(name, other) > rank for other in namesakes):
        # With labels shifted by one frame the scores would be wrong without an error.
        raise InputError(f"{path}: was drawn on {name!r}, expected labels of {view_name!r}")
    part = window or Window.covering(full_w, full_h, width, height)
    part.check_shape(path, full_w, full_h)
    masks, boxes = {}, {}
    for category in record.categories:  # one full-size mask in memory at a time
        drawn = np.zeros((full_h, full_w), np.uint8)
        corners = []
        for labelled in record.objects:
            if labelled.category == category:
                polygons = [labelled.segmentation, *labelled.holes]
                # Even-odd rule: pixels inside an even number of polygons are not filled.
                cv2.fillPoly(drawn, [np.array(p, np.float64).astype(np.int32) for p in polygons], 1)
                corners.append(labelled.bbox)
        masks[category] = part.mask(drawn, height, width)
        boxes[category] = part.boxes(np.stack(corners), (full_h, full_w), (height, width))
    return masks, boxes


def _classes(folder: Path) -> tuple[str, ...]:
    """Read the classes of class masks, sorted; InputError if there are none, or duplicates."""
    file = folder / CLASSES_FILE
    try:
        names = sorted(name for line in read_lines(file) if (name := line.strip(" \t")))
    except (OSError, UnicodeDecodeError) as bad:
        raise InputError(f"{file}: cannot be read ({bad})") from None
    if not names or len(set(names)) < len(names):
        raise InputError(f"{file}: found {names}, expected different classes, one a line")
    # Reject class names that leave the folder or are longer than a file name may be.
    if unfit := [n for n in names if "/" in n or "\0" in n or len(f"{n}.png".encode()) > 255]:
        raise InputError(f"{file}: the class {unfit[0]!r:.80} can be no file's name; rename it")
    return tuple(names)


def _read_class_masks(
    folder: Path, files: Sequence[Path], width: int, height: int, window: Window | None
) -> dict[str, np.ndarray]:
    masks = {}
    for name, file in zip(_classes(folder), files, strict=True):
        if not file.is_file():
            raise InputError(
                f"{file}: no such mask; every labelled frame needs one for each class of "
                f"{CLASSES_FILE}"
            )
        mask = read_mask(file, MASK_GREY)
        full_h, full_w = mask.shape
        part = window or Window.covering(full_w, full_h, width, height)
        part.check_shape(file, full_w, full_h)
        masks[name] = part.mask(mask, height, width)
    return masks


def _flat(corners: Any) -> Any:
    """Return two corners as one list."""
    if isinstance(corners, list) and all(isinstance(corner, list) for corner in corners):
        return [number for corner in corners for number in corner]
    return corners


_Coordinate = Annotated[float, Field(gt=-1e6, lt=1e6)]
"""A pixel coordinate; NaN fails both comparisons."""

_Polygon = Annotated[list[tuple[_Coordinate, _Coordinate]], Field(min_length=3)]


class _Object(BaseModel):
    category: Annotated[str, Field(pattern=r"\S")]
    segmentation: _Polygon
    holes: list[_Polygon] = []
    bbox: Annotated[list[_Coordinate], BeforeValidator(_flat), Field(min_length=4, max_length=4)]


class _Info(BaseModel):
    name: str
    width: PositiveInt
    height: PositiveInt


class _Record(BaseModel):
    """A label file."""

    info: _Info
    objects: list[_Object]

    @property
    def categories(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(item.category for item in self.objects))


def _read_record(path: Path) -> _Record:
    record = check_document(_Record, read_json(path, "label file"), str(path))
    try:
        check_size(record.info.width, record.info.height)
    except TooLargeError as bad:
        raise InputError(f"{path}: info: {bad}, and draw the labels anew") from None
    _check_polygons(path, record)
    boxes = _boxes(path, record)
    items = zip(record.objects, boxes, strict=True)
    return record.model_copy(
        update={"objects": [item.model_copy(update={"bbox": box.tolist()}) for item, box in items]}
    )


def _check_polygons(path: Path, record: _Record) -> None:
    """Raise InputError for a polygon outside the picture or in one pixel, or a hole outside it."""
    size = np.array([record.info.width, record.info.height])
    for item in record.objects:
        low, high = span = _bounds(item.segmentation)
        place = f"{path}: {item.category!r}: its polygon spans {_text(span)}"
        if (high - low).max() <= 1 < size.max():
            raise InputError(
                f"{place}, a pixel at most of the {size[0]}x{size[1]} that info gives; give pixels "
                "and not fractions of the picture"
            )
        if (low < -OUTSIDE * size).any() or (high > (1 + OUTSIDE) * size).any():
            raise InputError(
                f"{place}, outside the {size[0]}x{size[1]} pixels that info gives; correct the "
                "one or the other"
            )
        for hole in map(_bounds, item.holes):
            if (hole[0] < low - BOX_SLACK).any() or (hole[1] > high + BOX_SLACK).any():
                raise InputError(f"{place}, and a hole of it {_text(hole)}; put it inside")


def _boxes(path: Path, record: _Record) -> list[np.ndarray]:
    """Return the boxes [4] of the objects as x0, y0, x1, y1, in the form that polygons confirm.

    Raises:
        InputError: If a polygon confirms neither corners nor COCO's x, y, width, height.
    """
    boxes, converted = [], []
    parts: dict[str, list[tuple[float, float]]] = {}
    for item in record.objects:
        parts.setdefault(item.category, []).extend(item.segmentation)
    for item in record.objects:
        first, second = given = np.array(item.bbox, np.float64).reshape(2, 2)
        corners = np.stack([given.min(0), given.max(0)])  # corners in any order
        # An object in several parts may have the box of all of them.
        spans = [_bounds(item.segmentation), _bounds(parts[item.category])]
        slack = BOX_SLACK + BOX_SHARE * np.ptp(spans[0], axis=0).max()
        forms = corners, np.stack([first, first + second]), corners[:, ::-1]
        fits = [any(np.abs(form - span).max() <= slack for span in spans) for form in forms]
        overlap = [max(_overlap(form, span) for span in spans) for form in forms]
        is_coco = (fits[1], overlap[1]) > (fits[0], overlap[0]) and not fits[0]
        if not fits[is_coco] and (fits[2] or overlap[is_coco] < MIN_BOX_OVERLAP):
            raise InputError(
                f"{path}: {item.category!r}: its box is {_text(given)}, but its polygon spans "
                f"{_text(spans[0])}; give x0, y0, x1, y1 of it"
            )
        boxes.append(forms[is_coco].ravel())
        converted += [item.category] * is_coco
    if converted:
        warnings.warn(
            f"{path}: {len(converted)} boxes are x, y, width, height, as their polygons show, and "
            f"are read so, the first of {converted[0]!r}",
            stacklevel=2,
        )
    return boxes


def _bounds(points: Sequence[tuple[float, float]]) -> np.ndarray:
    """Return the smallest and largest x, y of points, float64 [2, 2]."""
    at = np.array(points, np.float64)
    return np.stack([at.min(0), at.max(0)])


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Compute the IoU of two boxes [2, 2]."""
    both = np.prod((np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])).clip(0))
    return float(both / max(np.prod(a[1] - a[0]) + np.prod(b[1] - b[0]) - both, 1e-9))


def _text(box: np.ndarray) -> str:
    (x0, y0), (x1, y1) = box
    return f"{x0:g}, {y0:g}, {x1:g}, {y1:g}"
