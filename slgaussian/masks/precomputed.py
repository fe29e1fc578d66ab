"""The tracker ``precomputed``: id maps made elsewhere, as by DEVA, Cutie or SAM 3, from files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import PrivateAttr

from slgaussian.errors import InputError
from slgaussian.masks.configs import MAPS, PrecomputedConfig

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

TOP = 2**31 - 1
TOP_PNG = 2**16 - 1
"""The largest id, in any map and in a grey PNG."""


class Precomputed(PrecomputedConfig):
    """Labels out of a folder that holds one id map a view, with ids that agree across views.

    A map is called like its view: for ``images/0013.jpg`` it is ``images/0013.png``, or else
    ``0013.png``, in the folder; or ``.npy``. Its pixels are ids above 0 of objects, and 0 where
    there is none:

    - PNG, grey with up to 16 bits, or a palette: the value is the id;
    - PNG, colours with 8 bits: the id is red + 256 green + 65536 blue, as in COCO's panoptic
      format (https://github.com/cocodataset/panopticapi), so black is 0;
    - NPY, whole numbers [H, W]: the value is the id.

    The map may have any size, in the shape of its photograph, and is scaled and cropped as that
    was; or in the shape of the view. Each pixel takes the id at its centre. Ids are kept as they
    are, whatever their gaps and holes, and nothing is proposed, merged or voted on.

    Attributes
    ----------
    folder : path or str
        Has no default.

    Raises
    ------
    InputError
        If there is no such folder. When a map is read: if it is missing, cannot be read, has
        another type or shape, or is another view's too.
    """

    final: ClassVar[bool] = True
    repeatable: ClassVar[bool] = True
    _views: dict[Path, str] = PrivateAttr(default_factory=dict)

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.folder is None:
            raise InputError(
                "precomputed folder: none given; give the folder of the id maps, as in "
                "--set precomputed.folder=FOLDER"
            )
        if not self.folder.is_dir():
            raise InputError(f"precomputed folder: there is no folder {str(self.folder)!r}")

    def add(self, seen: SeenView, labels: np.ndarray) -> None:
        """Remember nothing: the files know better."""

    def propagate(self, seen: SeenView) -> np.ndarray:
        """Ids int32 [H, W] of a view, from its file."""
        view = seen.view
        file = self._find(view.name)
        other = self._views.setdefault(file, view.name)
        if other != view.name:
            raise InputError(
                f"{file}: is the id map of both {other!r} and {view.name!r}; put the maps into "
                f"folders like those of the views, as in {Path(view.name).with_suffix('.png')}"
            )
        ids = read_ids(file)
        height, width = view.image.shape[:2]
        from slgaussian.formats.resampling import Window

        drawn_on, cropped = view.shown, Window.whole(width, height)
        if ids.shape == (height, width) or (
            cropped.has_shape(*ids.shape[::-1]) and not drawn_on.has_shape(*ids.shape[::-1])
        ):
            drawn_on = cropped
        drawn_on.check_shape(file, *ids.shape[::-1])
        return drawn_on.ids(ids, height, width)

    def _find(self, name: str) -> Path:
        assert self.folder is not None  # looked at when this was made
        folder, view = self.folder, Path(name)
        nested = folder / view.with_suffix("")
        for base in dict.fromkeys((nested, folder / view.stem)):
            found = [base.with_name(base.name + s) for s in MAPS]
            found = [file for file in found if file.is_file()]
            if len(found) > 1:
                raise InputError(f"{found[0]}: {found[1].name} is there too; remove one of them")
            if found:
                return found[0]
        raise InputError(
            f"{folder}: has no id map of view {str(view)!r}; expected {view.stem}.png or "
            f"{view.stem}.npy"
        )


def map_names(views: Sequence[str]) -> dict[str, str]:
    """What the maps of views are called, by view and without suffix, so that they are found.

    The plain names of the views if they are unique, or else with their folders.

    Raises
    ------
    InputError
        If two views would have one map, or a map would lie outside the folder.
    """
    for names in (
        {view: Path(view).stem for view in views},
        {view: Path(view).with_suffix("").as_posix() for view in views},
    ):
        if len(set(names.values())) == len(names):
            break
    else:
        raise InputError(f"views {', '.join(views)}: two would have one id map; rename one of them")
    for view, name in names.items():
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise InputError(
                f"view {view!r}: its id map would lie outside the folder; give all photographs "
                "different names"
            )
    return names


def encode_ids(ids: np.ndarray) -> tuple[str, bytes]:
    """Suffix and content of the map int32 [H, W]: a grey PNG of 16 bits, or NPY for large ids."""
    from PIL import Image

    out = io.BytesIO()
    if ids.max(initial=0) <= TOP_PNG:
        Image.fromarray(ids.astype(np.uint16)).save(out, "PNG")
        return ".png", out.getvalue()
    np.save(out, ids)
    return ".npy", out.getvalue()


def read_ids(file: Path) -> np.ndarray:
    """The ids int32 [H, W] of one map; see :class:`Precomputed`.

    Raises
    ------
    InputError
        If the file cannot be read, or holds anything but ids.
    """
    ids = _read_npy(file) if file.suffix == ".npy" else _read_png(file)
    if ids.ndim != 2 or ids.size == 0:
        raise InputError(f"{file}: found shape {ids.shape}, expected ids [H, W]")
    if not np.issubdtype(ids.dtype, np.integer):
        raise InputError(f"{file}: found {ids.dtype}, expected whole numbers, as int32")
    low, high = int(ids.min()), int(ids.max())
    if low < 0 or high > TOP:
        raise InputError(
            f"{file}: found ids from {low} to {high}, expected 0 for no object and 1 to {TOP}"
        )
    return ids.astype(np.int32)


def _read_npy(file: Path) -> np.ndarray:
    from slgaussian.formats.images import read_npy

    try:
        return read_npy(file)
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read as NPY ({problem}); write it again") from None


def _read_png(file: Path) -> np.ndarray:
    from slgaussian.formats.images import opened

    try:
        with file.open("rb") as stream:
            head = stream.read(26)
        with opened(file, kinds=["PNG"]) as image:
            mode, pixels = image.mode, np.asarray(image)
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read as PNG ({problem}); write it again") from None
    bits = head[24]
    if mode == "1":
        return pixels.astype(np.uint8)
    if mode == "L":
        # Pillow spreads values of 2 and 4 bits over 0 to 255.
        return pixels // (255 // (2**bits - 1))
    if mode == "RGB" and bits == 8:
        return pixels @ np.array([1, 256, 65536], np.int32)
    if mode == "P" or mode.startswith("I"):
        return pixels
    raise InputError(
        f"{file}: is a PNG of {mode} with {bits} bits; expected grey, a palette, or RGB with 8 bits"
    )
