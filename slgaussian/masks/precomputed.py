"""The tracker and the proposer ``precomputed``: read masks of other programs.

The tracker reads ids that are the same in all views, as of DEVA, Cutie or SAM 3; the proposer reads
masks that differ from view to view, as of SAM, and the objects are associated as others are.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from slgaussian.checks import companion, namesakes
from slgaussian.errors import InputError
from slgaussian.masks import Proposals
from slgaussian.masks.configs import MAP_SUFFIXES, PrecomputedConfig

if TYPE_CHECKING:
    from slgaussian.formats.coco import Annotation, Coco
    from slgaussian.formats.mask_layouts import Layout
    from slgaussian.geometry import SeenView
    from slgaussian.labels import LabelMaps
    from slgaussian.scene import View

MAX_ID = 2**31 - 1
MAX_PNG_ID = 2**16 - 1
"""The largest id, in any map and in a grey PNG."""


class _Masks(PrecomputedConfig):
    """Masks of views in one of the layouts that :func:`recognise_layout` knows.

    A file belongs to a view by its name: for ``images/0013.jpg`` it is ``images/0013.png``, or else
    ``0013.png``, in the folder. Its masks may have any size with the aspect ratio of the
    photograph, and are then scaled and cropped like the photograph; or the aspect ratio of the
    view. Each pixel takes the value at its centre.

    Raises:
        InputError: If there is no such folder, or several layouts fit. When masks are read: if they
            are missing or unreadable, have another type or shape, or also belong to another view.
    """

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.folder is None:
            raise InputError(
                "precomputed folder: none given; give the folder of the id maps, as in "
                "--set precomputed.folder=FOLDER"
            )
        if not self.folder.exists():
            raise InputError(f"precomputed folder: there is no folder {str(self.folder)!r}")

    @cached_property
    def source(self) -> tuple[Layout, Path]:
        """Layout and place of the masks."""
        from slgaussian.formats.mask_layouts import recognise_layout

        assert self.folder is not None  # checked at construction
        return recognise_layout(self.folder)

    @cached_property
    def coco(self) -> Coco:
        """Content of the COCO file."""
        from slgaussian.formats.coco import read_coco

        return read_coco(self.source[1])

    def find(self, view: View, suffixes: Sequence[str], expected: str) -> Path:
        """Return the file of a view; InputError if there is none, with ``{}`` as its stem."""
        place = self.source[1]
        file = companion(place, view.name, suffixes, view.namesakes)
        if file is None:
            stem = Path(view.name).stem
            raise InputError(
                f"{place}: has no id map of view {view.name!r}; expected {expected.format(stem)}"
            )
        return file

    def annotations(self, view: View) -> Iterator[tuple[Annotation, np.ndarray]]:
        """Yield the objects of a view in a COCO file and their masks, bool [H, W].

        Crowds are left out, with a warning.
        """
        image = self.coco.find(view.name, view.namesakes)
        if image is None:
            raise InputError(f"{self.coco.place}: lists no image of view {view.name!r}; add it")
        for annotation in self.coco.annotations.get(image.id, ()):
            if annotation.iscrowd:
                place = f"{self.coco.place}: annotation {annotation.id}"
                warnings.warn(f"{place} is a crowd, not an object; left out", stacklevel=2)
                continue
            mask = self.coco.draw(annotation, image)
            yield annotation, _place(self.coco.place, view, mask)


class Precomputed(_Masks):
    """Labels with consistent ids across views; proposals, merging and voting are skipped.

    - A folder with an id map for each view, 0 where no object is. PNG, grey with up to 16 bits, or
      a palette: the value is the id. PNG, colours with 8 bits: the id is red + 256 green + 65536
      blue, as in COCO's panoptic format (https://github.com/cocodataset/panopticapi). NPY, integers
      [H, W]: the value is the id.
    - Gaussian Grouping's ``object_mask`` in the folder: the same.
    - A COCO file, or a folder with one, whose annotations have a ``track_id``. Where objects
      overlap, the smaller is on top. If a ``track_id`` is 0, an id is that plus one.

    Ids do not change.
    """

    final: ClassVar[bool] = True
    repeatable: ClassVar[bool] = True

    def add(self, frame: SeenView, labels: np.ndarray) -> None:
        """Do nothing, because all labels are in the files."""

    def propagate(self, frame: SeenView) -> np.ndarray:
        """Read the ids int32 [H, W] of a view from its file."""
        view = frame.view
        layout, place = self.source
        if layout == "langsplat":
            raise InputError(
                f"{place}: LangSplat's segments are not the same in all views; read them with "
                "--proposer precomputed"
            )
        if layout == "coco":
            shape, drawn = view.image.shape[:2], list(self.annotations(view))
            ids = np.zeros(shape, np.int32)
            for annotation, mask in sorted(drawn, key=lambda each: -each[1].sum()):
                ids[mask] = self.tracks[annotation.track]
        else:
            place = self.find(view, MAP_SUFFIXES, "{0}.png or {0}.npy")
            ids = _place(place, view, read_ids(place))
        if not ids.any():
            warnings.warn(f"{place}: the id map is empty, all of its ids are 0", stacklevel=2)
        return ids

    @cached_property
    def tracks(self) -> dict[int, int]:
        """Ids of the objects of a COCO file by ``track_id``.

        Raises:
            InputError: If an object has none, or one that is no id.
        """
        objects = [a for group in self.coco.annotations.values() for a in group if not a.iscrowd]
        for annotation in objects:
            track = annotation.track
            if type(track) is not int or not 0 <= track < MAX_ID:
                raise InputError(
                    f"{self.coco.place}: annotation {annotation.id} has the track_id "
                    f"{track!r:.40}, expected the number of its object in all images; read masks "
                    "without one with --proposer precomputed"
                )
        numbers = {annotation.track for annotation in objects}
        return {number: number + (0 in numbers) for number in numbers}


class PrecomputedProposer(_Masks):
    """Masks of each view from files; which of them are one object is found by association.

    - LangSplat's ``NAME_s.npy`` and ``NAME_f.npy``, also in ``language_features`` of the folder:
      the segments of all levels. The features are not used.
    - A COCO file, or a folder with one: its annotations, whose ``track_id`` is not used.
    - Id maps and Gaussian Grouping's masks, as for the tracker: each id is a mask.
    """

    def propose(self, frame: SeenView, region: np.ndarray | None = None) -> Proposals:
        """Read the masks of a view; none for a ``region``, as all are given before."""
        view, masks = frame.view, list[np.ndarray]()
        layout, _ = self.source
        if region is not None:
            return Proposals(np.zeros((0, *region.shape), bool), np.zeros(0, np.float32))
        if layout == "coco":
            masks = [mask for _, mask in self.annotations(view)]
        else:
            if layout == "langsplat":
                place = self.find(view, ["_s.npy"], "{0}_s.npy")
                levels = read_segments(place)
            else:
                place = self.find(view, MAP_SUFFIXES, "{0}.png or {0}.npy")
                levels = read_ids(place)[None]
            for level in levels:
                ids = _place(place, view, level)
                masks += [ids == id_ for id_ in np.unique(ids[ids > 0])]
        masks = [mask for mask in masks if mask.any()]
        stack = np.array(masks, bool).reshape(-1, *view.image.shape[:2])
        return Proposals(stack, np.ones(len(stack), np.float32))


def _place(file: Path, view: View, values: np.ndarray) -> np.ndarray:
    """Resample the values [H, W] of a file to a view, at the centres of its pixels."""
    from slgaussian.formats.resampling import Window

    height, width = view.image.shape[:2]
    drawn_on, cropped = view.visible_window, Window.whole(width, height)
    if values.shape == (height, width) or (
        cropped.has_shape(*values.shape[::-1]) and not drawn_on.has_shape(*values.shape[::-1])
    ):
        drawn_on = cropped
    drawn_on.check_shape(file, *values.shape[::-1])
    return drawn_on.ids(values, height, width)


def map_names(views: Sequence[str], others: Sequence[str] = ()) -> dict[str, str]:
    """Return the names of the id maps by view, without suffix.

    They are the file names of the views if these are unique, also among ``others``, the names of
    further photographs of the scene; or else include their folders.

    Raises:
        InputError: If two views would have one map, or a map would lie outside the folder.
    """
    names = {view: Path(view).stem for view in views}
    if len(set(names.values())) < len(names) or any(namesakes(view, others) for view in views):
        names = {view: Path(view).with_suffix("").as_posix() for view in views}
    if len(set(names.values())) < len(names):
        raise InputError(f"views {', '.join(views)}: two would have one id map; rename one of them")
    for view, name in names.items():
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(
                f"view {view!r}: its id map would lie outside the folder; give all photographs "
                "different names"
            )
    return names


def write_ids(folder: Path, views: Sequence[View], maps: LabelMaps) -> dict[str, str]:
    """Write a map of each view, as :func:`encode_ids`; return the file of each view."""
    others, files = [name for view in views for name in view.namesakes], {}
    names = map_names([view.name for view in views], others)
    for view, ids in zip(views, maps.labels, strict=True):
        suffix, data = encode_ids(ids)
        files[view.name] = names[view.name] + suffix
        file = folder / files[view.name]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    return files


def encode_ids(ids: np.ndarray) -> tuple[str, bytes]:
    """Encode a map int32 [H, W] as 16-bit grey PNG, or NPY for large ids; return suffix, bytes."""
    from PIL import Image

    out = io.BytesIO()
    if ids.max(initial=0) <= MAX_PNG_ID:
        Image.fromarray(ids.astype(np.uint16)).save(out, "PNG")
        return ".png", out.getvalue()
    np.save(out, ids)
    return ".npy", out.getvalue()


def read_ids(file: Path) -> np.ndarray:
    """Read the ids int32 [H, W] of one map; see :class:`Precomputed`.

    Raises:
        InputError: If the file cannot be read, or has invalid ids.
    """
    from slgaussian.formats.images import read_npy

    try:
        ids = read_npy(file) if file.suffix == ".npy" else _read_png(file)
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read as ids ({problem}); write it again") from None
    if ids.ndim != 2 or ids.size == 0:
        raise InputError(f"{file}: found shape {ids.shape}, expected ids [H, W]")
    if not np.issubdtype(ids.dtype, np.integer):
        raise InputError(f"{file}: found {ids.dtype}, expected whole numbers, as int32")
    low, high = int(ids.min()), int(ids.max())
    if low < 0 or high > MAX_ID:
        raise InputError(
            f"{file}: found ids from {low} to {high}, expected 0 for no object and 1 to {MAX_ID}"
        )
    return ids.astype(np.int32)


def read_segments(file: Path) -> np.ndarray:
    """Read LangSplat's segments as int32 [L, H, W] from 1 on, 0 for none.

    Raises:
        InputError: If the file cannot be read, or has other values.
    """
    from slgaussian.formats.images import read_npy

    try:
        segments = read_npy(file)
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read ({problem}); write it again") from None
    is_whole = np.issubdtype(segments.dtype, np.number) and (segments % 1 == 0).all()
    if segments.ndim != 3 or not segments.size or not is_whole or segments.min() < -1:
        raise InputError(
            f"{file}: found {segments.dtype} {segments.shape}, expected segments [levels, H, W], "
            "whole numbers from -1 on"
        )
    return segments.astype(np.int32) + 1


def _read_png(file: Path) -> np.ndarray:
    from slgaussian.formats.images import open_image

    with file.open("rb") as stream:
        bits = stream.read(26)[24:25]
    with open_image(file, kinds=["PNG"]) as image:
        mode, pixels = image.mode, np.asarray(image)
    if mode == "1":
        return pixels.astype(np.uint8)
    if mode == "L":
        # Pillow scales values of 2 and 4 bits to 0 to 255.
        return pixels // (255 // (2 ** bits[0] - 1))
    if mode == "RGB" and bits[0] == 8:
        return pixels @ np.array([1, 256, 65536], np.int32)
    if mode == "P" or mode.startswith("I"):
        return pixels
    raise ValueError(
        f"it is a PNG of {mode} with {bits[0]} bits, expected grey, a palette, or RGB with 8 bits"
    )
