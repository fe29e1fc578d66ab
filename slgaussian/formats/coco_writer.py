"""Writing of label maps as COCO's JSON (:mod:`slgaussian.formats.coco`)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian.formats import rle
from slgaussian.formats.polygons import trace_polygons
from slgaussian.labels import LabelMaps

if TYPE_CHECKING:
    from slgaussian.scene import View

COCO_FILE = "annotations.json"

POLYGON_TOLERANCE = 0.35
"""Largest distance of an outline's points from its polygon, pixels of the label map. Hardly any
pixel's centre is nearer to an outline; at 0.5, polygons with a third fewer points have a mean IoU
of 0.994 with the objects of two photographs."""


def write_coco(
    folder: Path,
    views: Sequence[View],
    maps: LabelMaps,
    words: Mapping[int, str],
    polygons: bool = False,
) -> dict[str, str]:
    """Write label maps as COCO's JSON; return the file of each view.

    Args:
        words: Name of the category of each object by id; equal names are one category.
        polygons: Write outlines within :data:`POLYGON_TOLERANCE` in place of run lengths.
    """
    categories = {name: n for n, name in enumerate(dict.fromkeys(words.values()), start=1)}
    images, annotations = [], list[dict[str, Any]]()
    for number, (view, labels) in enumerate(zip(views, maps.labels, strict=True), start=1):
        window = view.visible_window
        height, width = window.photo_height, window.photo_width
        ids = window.spread_ids(labels, height, width)
        image = {"id": number, "file_name": view.name, "width": width, "height": height}
        images.append(image)
        for id_, mask in rle.encode_ids(ids).items():
            shape = _outline(view, labels == id_) if polygons else _runs(mask, ids == id_)
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": number,
                    "category_id": categories[words[id_]],
                    "iscrowd": 0,
                    **shape,
                    "track_id": id_,
                    "attributes": {"track_id": id_},
                }
            )
    document = {
        "info": {"description": "Objects of photographs; track_id is the same in all of them"},
        "licenses": [],
        "images": images,
        "categories": [{"id": n, "name": name} for name, n in categories.items()],
        "annotations": annotations,
    }
    (folder / COCO_FILE).write_text(json.dumps(document) + "\n", "utf-8")
    return {view.name: COCO_FILE for view in views}


def _runs(mask: rle.RunLengths, pixels: np.ndarray) -> dict[str, Any]:
    """Describe a mask bool [H, W] by its run lengths."""
    rows, columns = np.flatnonzero(pixels.any(1)), np.flatnonzero(pixels.any(0))
    x, y = int(columns[0]), int(rows[0])
    return {
        "segmentation": {"size": [mask.height, mask.width], "counts": mask.counts},
        "area": int(pixels.sum()),
        "bbox": [x, y, int(columns[-1]) + 1 - x, int(rows[-1]) + 1 - y],
    }


def _outline(view: View, mask: np.ndarray) -> dict[str, Any]:
    """Describe a mask bool [H, W] of a view by polygons in pixels of its photograph."""
    window = view.visible_window
    scale = np.divide(
        (window.right - window.left, window.bottom - window.top), (mask.shape[1], mask.shape[0])
    )
    rings = trace_polygons(mask, POLYGON_TOLERANCE)
    rings = [np.round(ring * scale + (window.left, window.top), 2) for ring in rings]
    low, high = np.concatenate(rings).min(0), np.concatenate(rings).max(0)
    areas = [x @ np.roll(y, -1) - y @ np.roll(x, -1) for x, y in (ring.T for ring in rings)]
    return {
        "segmentation": [ring.ravel().tolist() for ring in rings],
        "area": round(float(np.abs(areas).sum() / 2), 2),
        "bbox": np.round([*low, *(high - low)], 2).tolist(),
    }
