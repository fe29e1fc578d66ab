"""Layouts of object masks that other programs read: Gaussian Grouping, LangSplat and COCO.

- Gaussian Grouping (https://github.com/lkeab/gaussian-grouping):
  ``object_mask/NAME.png``, grey with 8 bits, the same id in all views, 0 for none. Its loader does
  not resize: masks have the size of the photographs (``-r 1``).
- LangSplat (https://github.com/minghanqin/LangSplat): ``language_features/NAME_s.npy`` [4, H, W],
  the segments of a view at the levels default, small, middle and large, -1 for none, and
  ``NAME_f.npy`` [K, C], the feature of each. A segment is the row of its feature; the rows of a
  level follow those of the level before. Photographs with more than 1,080 rows are shrunk to that.
- COCO (:mod:`slgaussian.formats.coco`): a JSON file.

The first two name files by the photograph without folder and without all after the first dot.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.coco import find_coco
from slgaussian.labels import LabelMaps

if TYPE_CHECKING:
    from slgaussian.language.bank import MemoryBank
    from slgaussian.scene import View

Layout = Literal["ids", "gaussian-grouping", "langsplat", "coco"]

OBJECT_MASKS, LANGUAGE_FEATURES = "object_mask", "language_features"

MAX_OBJECTS = 255
"""Largest number of objects in masks with 8 bits."""

FEATURE_WIDTH = 512
"""Width of features that LangSplat's programs are made for, that of CLIP's ViT-B/16."""

MAX_ROWS = 1080
"""Rows to which LangSplat shrinks photographs."""


def write_grouping(folder: Path, views: Sequence[View], maps: LabelMaps) -> dict[str, str]:
    """Write label maps as Gaussian Grouping's masks; return the file of each view.

    Of more than :data:`MAX_OBJECTS` objects the largest are kept, and ids above that are numbered
    anew, both with a warning.
    """
    from PIL import Image

    names, ids = loader_names(views), maps.ids
    largest = np.argsort(-maps.areas().sum(1), kind="stable")[:MAX_OBJECTS]
    chosen = np.sort(ids[largest])
    if len(ids) > MAX_OBJECTS:
        warnings.warn(
            f"{len(ids)} objects: masks with 8 bits hold {MAX_OBJECTS}, so the "
            f"{len(ids) - MAX_OBJECTS} smallest are left out",
            stacklevel=2,
        )
    if chosen.max(initial=0) > MAX_OBJECTS:
        warnings.warn(f"ids above {MAX_OBJECTS}: all are numbered anew from 1", stacklevel=2)
        numbers = np.arange(1, len(chosen) + 1)
    else:
        numbers = chosen
    table = np.zeros(len(ids) + 1, np.uint8)
    table[np.searchsorted(ids, chosen) + 1] = numbers
    (folder / OBJECT_MASKS).mkdir()
    files = {}
    for view, labels in zip(views, maps.labels, strict=True):
        rows = np.searchsorted(ids, labels, side="right")
        files[view.name] = f"{OBJECT_MASKS}/{names[view.name]}.png"
        window = view.visible_window
        mask = window.spread_ids(table[rows], window.photo_height, window.photo_width)
        Image.fromarray(mask).save(folder / files[view.name])
    return files


def write_langsplat(
    folder: Path, views: Sequence[View], maps: LabelMaps, bank: MemoryBank
) -> dict[str, str]:
    """Write the objects and groups of a bank as LangSplat's features; return the file of each view.

    Default and small are the objects, middle and large their groups, the finer ones first. Warns if
    the features are wider or narrower than :data:`FEATURE_WIDTH`.
    """
    if (width := bank.features.shape[2]) != FEATURE_WIDTH:
        warnings.warn(
            f"features have {width} numbers, where LangSplat's programs expect {FEATURE_WIDTH}, as "
            "those of the encoder clip",
            stacklevel=2,
        )
    names, files = loader_names(views), {}
    objects = np.arange(len(bank.ids))
    groups = [objects] * 2 if bank.levels is None else list(bank.levels)
    levels = [objects, objects, *sorted(groups, key=lambda level: -len(np.unique(level)))]
    (folder / LANGUAGE_FEATURES).mkdir()
    for number, (view, labels) in enumerate(zip(views, maps.labels, strict=True)):
        window = view.visible_window
        scale = max(1.0, window.photo_height / MAX_ROWS)
        size = int(window.photo_height / scale), int(window.photo_width / scale)
        ids = window.spread_ids(labels, *size)
        segments = np.full((len(levels), *ids.shape), -1, np.int32)
        features: list[np.ndarray] = []
        for segment, level in zip(segments, levels, strict=True):
            nodes, places = np.unique(
                level[np.searchsorted(bank.ids, ids[ids > 0])], return_inverse=True
            )
            segment[ids > 0] = places + sum(map(len, features))
            features.append(bank.nodes[0][nodes, number])
        place = folder / LANGUAGE_FEATURES / names[view.name]
        np.save(f"{place}_s.npy", segments)
        np.save(f"{place}_f.npy", np.concatenate(features))
        files[view.name] = f"{LANGUAGE_FEATURES}/{names[view.name]}_s.npy"
    return files


def loader_names(views: Sequence[View]) -> dict[str, str]:
    """Return the file names, without suffix, by which loaders find the files of views.

    Raises:
        InputError: If two views have the same one, or one has a dot, at which loaders cut it.
    """
    names = {view.name: Path(view.name).stem for view in views}
    for view, name in names.items():
        same = [other for other in names if names[other] == name and other != view]
        if same or "." in name:
            reason = f"as {same[0]!r} has that name too" if same else "which has a dot"
            raise InputError(
                f"view {view!r}: programs that read this layout cannot tell {name!r}, {reason}; "
                "rename the photograph"
            )
    return names


def recognise_layout(place: Path) -> tuple[Layout, Path]:
    """Recognise the layout of masks from what a folder contains.

    Returns:
        layout: "coco" for a file, and "ids" for a folder without any other layout.
        place: The file of COCO, or the folder with a file for each view.

    Raises:
        InputError: If two layouts fit.
    """
    if place.is_file():
        return "coco", place
    fitting: list[tuple[Layout, Path]] = []
    if (place / OBJECT_MASKS).is_dir():
        fitting.append(("gaussian-grouping", place / OBJECT_MASKS))
    for folder in (place, place / LANGUAGE_FEATURES):
        segments = {file.name[: -len("_s.npy")] for file in folder.glob("*_s.npy")}
        features = {file.name[: -len("_f.npy")] for file in folder.glob("*_f.npy")}
        if segments & features:
            fitting.append(("langsplat", folder))
    if (coco := find_coco(place)) is not None:
        fitting.append(("coco", coco))
    maps = [*place.glob("*.png"), *place.glob("*.npy")]
    if any(not file.name.endswith(("_s.npy", "_f.npy")) for file in maps):
        fitting.append(("ids", place))
    if len(fitting) > 1:
        layouts = " and ".join(f"{layout} ({where.name})" for layout, where in fitting)
        raise InputError(f"{place}: has masks in the layouts {layouts}; give a place with one")
    return fitting[0] if fitting else ("ids", place)
