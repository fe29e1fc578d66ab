"""Ground truth from a COCO file (:mod:`slgaussian.formats.coco`), whose categories are the texts.

An image with annotations is a labelled frame; the others are unknown, not empty. The annotations of
a category are united, crowds too, as a text asks for pixels and not for single objects. Boxes are
those of the masks.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from slgaussian.checks import name_parts
from slgaussian.errors import InputError
from slgaussian.formats.coco import read_coco
from slgaussian.formats.resampling import Window


def list_frames(folder: Path, file: Path) -> dict[str, tuple[str, ...]]:
    """List the categories of each labelled frame, by its path without suffix.

    Raises:
        InputError: If the file is damaged, or the folder has label files of frames, too.
    """
    others = (other for other in sorted(folder.rglob("*.json")) if other != file)
    if other := next((other for other in others if b'"objects"' in other.read_bytes()), None):
        raise InputError(
            f"{folder}: {file.name} has labels of COCO, and {other.name} those of a frame; give "
            "the one or the other"
        )
    coco = read_coco(file)
    return {
        "/".join(name_parts(name)): tuple(
            dict.fromkeys(coco.categories[a.category_id] for a in coco.annotations[image.id])
        )
        for name, image in sorted(coco.images.items())
        if image.id in coco.annotations
    }


def read_frame(
    file: Path,
    view_name: str,
    namesakes: Sequence[str],
    width: int,
    height: int,
    window: Window | None,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Read masks bool [height, width] and boxes float64 [n, 4] of a frame by category.

    Raises:
        InputError: If the file is damaged, the frame is not labelled, or its labels have another
            aspect ratio.
    """
    coco = read_coco(file)
    image = coco.find(view_name, namesakes)
    if image is None or image.id not in coco.annotations:
        fault = "lists no image" if image is None else "has no annotation"
        raise InputError(
            f"{file}: {fault} of {view_name!r}, so it is not labelled; label it, or ask another"
        )
    part = window or Window.covering(image.width, image.height, width, height)
    part.check_shape(f"{file}: {image.file_name!r}", image.width, image.height)
    drawn: dict[str, np.ndarray] = {}
    corners: dict[str, list[tuple[int, ...]]] = {}
    for annotation in coco.annotations[image.id]:
        category, mask = coco.categories[annotation.category_id], coco.draw(annotation, image)
        drawn[category] = drawn.get(category, False) | mask
        x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
        corners.setdefault(category, []).extend([(x, y, x + w, y + h)] if w else [])
    shapes = (image.height, image.width), (height, width)
    masks = {name: part.mask(mask, height, width) for name, mask in drawn.items()}
    return masks, {
        name: part.boxes(np.array(rows, np.float64).reshape(-1, 4), *shapes)
        for name, rows in corners.items()
    }
