"""The tracker ``precomputed``: reads id maps of other programs, such as DEVA, Cutie or SAM 3."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from slgaussian.checks import companion, namesakes
from slgaussian.errors import InputError
from slgaussian.masks.configs import MAP_SUFFIXES, PrecomputedConfig

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

MAX_ID = 2**31 - 1
MAX_PNG_ID = 2**16 - 1
"""The largest id, in any map and in a grey PNG."""


class Precomputed(PrecomputedConfig):
    """Labels from a folder with one id map for each view and consistent ids across views.

    A map has the name of its view: for ``images/0013.jpg`` it is ``images/0013.png``, or else
    ``0013.png``, in the folder; or ``.npy``. Its pixels are object ids above 0, and 0 elsewhere:

    - PNG, grey with up to 16 bits, or a palette: the value is the id;
    - PNG, colours with 8 bits: the id is red + 256 green + 65536 blue, as in COCO's panoptic
      format (https://github.com/cocodataset/panopticapi), so black is 0;
    - NPY, integers [H, W]: the value is the id.

    The map may have any size with the aspect ratio of its photograph, and is then scaled and
    cropped like the photograph; or the aspect ratio of the view. Each pixel takes the id at its
    centre. Ids do not change, and proposals, merging and voting are skipped.

    Raises:
        InputError: If there is no such folder. When a map is read: if it is missing or unreadable,
            has another type or shape, or also belongs to another view.
    """

    final: ClassVar[bool] = True
    repeatable: ClassVar[bool] = True

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.folder is None:
            raise InputError(
                "precomputed folder: none given; give the folder of the id maps, as in "
                "--set precomputed.folder=FOLDER"
            )
        if not self.folder.is_dir():
            raise InputError(f"precomputed folder: there is no folder {str(self.folder)!r}")

    def add(self, frame: SeenView, labels: np.ndarray) -> None:
        """Do nothing, because all labels are in the files."""

    def propagate(self, frame: SeenView) -> np.ndarray:
        """Read the ids int32 [H, W] of a view from its file."""
        view = frame.view
        assert self.folder is not None  # checked at construction
        file = companion(self.folder, view.name, MAP_SUFFIXES, view.namesakes)
        if file is None:
            stem = Path(view.name).stem
            raise InputError(
                f"{self.folder}: has no id map of view {view.name!r}; expected {stem}.png or "
                f"{stem}.npy"
            )
        ids = read_ids(file)
        if not ids.any():
            warnings.warn(f"{file}: the id map is empty, all of its ids are 0", stacklevel=2)
        height, width = view.image.shape[:2]
        from slgaussian.formats.resampling import Window

        drawn_on, cropped = view.visible_window, Window.whole(width, height)
        if ids.shape == (height, width) or (
            cropped.has_shape(*ids.shape[::-1]) and not drawn_on.has_shape(*ids.shape[::-1])
        ):
            drawn_on = cropped
        drawn_on.check_shape(file, *ids.shape[::-1])
        return drawn_on.ids(ids, height, width)


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
