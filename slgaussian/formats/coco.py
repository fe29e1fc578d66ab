"""COCO's JSON of objects in photographs: https://cocodataset.org/#format-data.

``images`` have ``id``, ``file_name``, ``width`` and ``height``; ``categories`` have ``id`` and
``name``; ``annotations`` have ``image_id``, ``category_id`` and ``segmentation``. That is a list of
polygons ``[x0, y0, x1, y1, ...]`` in pixels, whose union is meant, or run lengths ``{"size":
[height, width], "counts": ...}`` (:mod:`slgaussian.formats.rle`). Objects that are the same in
several photographs share ``track_id``, as in TAO (https://taodataset.org), or
``attributes.track_id``, as CVAT writes it. Other keys are not used; boxes follow from the masks.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field, PositiveInt

from slgaussian.checks import matching
from slgaussian.errors import InputError
from slgaussian.formats import rle
from slgaussian.formats.documents import check_document, read_json
from slgaussian.formats.images import TooLargeError, check_size
from slgaussian.formats.polygons import fill_polygon
from slgaussian.io import short_repr

OUTSIDE = 0.05
"""Share of the picture by which a polygon may pass its border."""


class Image(BaseModel):
    """A photograph of the file."""

    id: int
    file_name: Annotated[str, Field(pattern=r"\S")]
    width: PositiveInt
    height: PositiveInt


class Annotation(BaseModel):
    """An object in a photograph, or a crowd of them."""

    id: int | str | None = None
    image_id: int
    category_id: int
    segmentation: Any = None
    iscrowd: bool = False
    track_id: int | None = None
    attributes: Any = None

    @property
    def track(self) -> Any:
        """Number of the object that is the same in all photographs; None without one."""
        given = self.attributes if isinstance(self.attributes, dict) else {}
        return given.get("track_id") if self.track_id is None else self.track_id


class _Category(BaseModel):
    id: int
    name: Annotated[str, Field(pattern=r"\S")]


class _Document(BaseModel):
    images: list[Image]
    annotations: list[Annotation]
    categories: list[_Category]


@dataclass(frozen=True, eq=False)
class Coco:
    """Content of a file.

    Attributes:
        place: The file.
        images: By file name.
        annotations: By id of the image; images without annotations are absent.
        categories: Name by id.
    """

    place: Path
    images: Mapping[str, Image]
    annotations: Mapping[int, Sequence[Annotation]]
    categories: Mapping[int, str]

    __repr__ = short_repr

    def find(self, view: str, others: Sequence[str] = ()) -> Image | None:
        """Return the image of a view, None if it is not listed; raises as ``matching``."""
        name = matching(str(self.place), view, self.images, others)
        return None if name is None else self.images[name]

    def draw(self, annotation: Annotation, image: Image) -> np.ndarray:
        """Draw the mask of an annotation, bool [height, width] of its image.

        Raises:
            InputError: If its run lengths are damaged.
        """
        size, segmentation = (image.height, image.width), annotation.segmentation
        if isinstance(segmentation, dict):
            try:
                return rle.decode(segmentation["counts"], *size)
            except ValueError as bad:
                raise InputError(f"{_name(self.place, annotation)}: {bad}; save it anew") from None
        polygons = [np.reshape(np.array(flat, np.float64), (-1, 2)) for flat in segmentation]
        return np.any([fill_polygon(polygon, *size) for polygon in polygons], axis=0)


def find_coco(place: Path) -> Path | None:
    """Return the COCO file of a folder, or ``place`` itself if it is a file; None without one.

    Raises:
        InputError: If the folder has several.
    """
    if place.is_file():
        return place
    contents = ((file, file.read_bytes()) for file in sorted(place.glob("*.json")))
    files = [file for file, text in contents if b'"annotations"' in text and b'"images"' in text]
    if len(files) > 1:
        raise InputError(
            f"{place}: {files[0].name} and {files[1].name} are both COCO's; give one of the files"
        )
    return files[0] if files else None


def read_coco(file: Path) -> Coco:
    """Read and check a COCO file.

    Raises:
        InputError: If it is no COCO file, an id is unknown or given twice, or a segmentation is
            missing, of another size than its image, or outside it.
    """
    document = check_document(_Document, read_json(file, "COCO file"), str(file))
    for kind, values in (
        ("images: id", [image.id for image in document.images]),
        ("images: file_name", [image.file_name for image in document.images]),
        ("categories: id", [category.id for category in document.categories]),
    ):
        for value, times in Counter[int | str](values).items():
            if times > 1:
                raise InputError(f"{file}: {kind} {value!r} is given twice; remove one of them")
    images = {image.id: image for image in document.images}
    categories = {category.id: category.name for category in document.categories}
    annotations: dict[int, list[Annotation]] = {}
    for annotation in document.annotations:
        for key, known in (("image_id", images), ("category_id", categories)):
            if (number := getattr(annotation, key)) not in known:
                kind = "images" if key == "image_id" else "categories"
                raise InputError(
                    f"{_name(file, annotation)}: its {key} {number} is none of the {kind}; add it "
                    "there, or correct it"
                )
        _check_segmentation(_name(file, annotation), annotation, images[annotation.image_id])
        annotations.setdefault(annotation.image_id, []).append(annotation)
    return Coco(file, {i.file_name: i for i in document.images}, annotations, categories)


def _name(file: Path, annotation: Annotation) -> str:
    return f"{file}: annotation {annotation.id}"


def _check_segmentation(place: str, annotation: Annotation, image: Image) -> None:
    """Raise InputError for a segmentation that is of another kind or size than its image."""
    try:
        check_size(image.width, image.height)
    except TooLargeError as bad:
        raise InputError(f"{place}: image {image.file_name!r}: {bad}") from None
    segmentation, size = annotation.segmentation, [image.height, image.width]
    if isinstance(segmentation, dict):
        if segmentation.get("size") != size or "counts" not in segmentation:
            raise InputError(
                f"{place}: its run lengths have size {segmentation.get('size')!r:.40}, expected "
                f"counts and {size}, the height and width of its image"
            )
        return
    if not isinstance(segmentation, list) or not segmentation:
        raise InputError(
            f"{place}: found the segmentation {segmentation!r:.40}, expected polygons or run "
            "lengths; a box is not enough"
        )
    for flat in segmentation:
        is_list = isinstance(flat, list) and len(flat) >= 6 and len(flat) % 2 == 0
        if not is_list or not all(type(n) in (int, float) and math.isfinite(n) for n in flat):
            raise InputError(
                f"{place}: found the polygon {flat!r:.40}, expected x0, y0, x1, y1, x2, y2 or more"
            )
        points = np.reshape(flat, (-1, 2)) / (image.width, image.height)
        if points.min() < -OUTSIDE or points.max() > 1 + OUTSIDE:
            x, y = flat[::2], flat[1::2]
            raise InputError(
                f"{place}: its polygon spans {min(x):g}, {min(y):g}, {max(x):g}, {max(y):g}, "
                f"outside the {image.width}x{image.height} pixels of {image.file_name!r}; correct "
                "the one or the other"
            )
