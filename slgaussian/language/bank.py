"""The multi-view language memory bank: for each ID code, what every view says about the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language import Encoder
from slgaussian.language.nearest import MOST_DIMENSIONS
from slgaussian.language.relevancy import UNIT_TOLERANCE
from slgaussian.language.room import Surroundings
from slgaussian.scene import View


@dataclass(frozen=True, eq=False)
class MemoryBank:
    """``{ID: {L_1 ... L_V}}`` of section 3.2, as arrays over N objects.

    The paper writes a zero vector where a view does not hold the object; a zero vector would score
    0.5 against everything, so here such a view is marked absent and never scored.

    Features are stored in half precision. :func:`build_bank` rounds them to it, so that a bank that
    was stored answers as the one just built did.

    Attributes
    ----------
    ids : int32 [N]
        Object ids as in the label maps, positive and ascending.
    codes : float32 [N, D]
        ID codes in [0, 1], all different, D from 1 to 3. With D = 0 there are none, and Gaussians
        carry the number of the object's row here; see :class:`slgaussian.semantic.Lifting`.
    features : float32 [N, V, C]
        Unit vectors of the encoder that built the bank; zero where absent. Their lengths are off
        by less than :data:`slgaussian.language.relevancy.UNIT_TOLERANCE`.
    present : bool [N, V]
        Which views hold the object.
    boxes : int32 [N, V, 4], optional
        Where each view shows the object: the first column and row, and those after the last, in
        pixels of the view; zeros where absent. To cut out what the object looks like.

    Raises
    ------
    InputError
        If any of this does not hold; the message names the array and the object.
    """

    ids: np.ndarray
    codes: np.ndarray
    features: np.ndarray
    present: np.ndarray
    boxes: np.ndarray | None = None

    def __post_init__(self) -> None:
        n = len(self.ids)
        views, width = self.features.shape[1:] if self.features.ndim == 3 else (0, 0)
        expected = {
            "ids": ("int32", (n,)),
            "codes": ("float32", (n, self.dimension)),
            "features": ("float32", (n, views, width)),
            "present": ("bool", (n, views)),
        }
        if self.boxes is not None:
            expected["boxes"] = ("int32", (n, views, 4))
        for name, (dtype, shape) in expected.items():
            array = getattr(self, name)
            if array.dtype != dtype or array.shape != shape:
                raise InputError(
                    f"memory bank {name}: found {array.dtype} {array.shape}, "
                    f"expected {dtype} {shape}"
                )
        if n and (self.ids[0] < 1 or (np.diff(self.ids) <= 0).any()):
            raise InputError("memory bank ids: expected positive ids in ascending order")
        if not ((self.codes >= 0) & (self.codes <= 1)).all():
            raise InputError("memory bank codes: found NaN or numbers outside [0, 1]")
        if self.dimension > MOST_DIMENSIONS:
            raise InputError(
                f"memory bank codes: found {self.dimension} numbers a code, expected at most "
                f"{MOST_DIMENSIONS}"
            )
        if self.dimension and len(np.unique(self.codes, axis=0)) != n:
            raise InputError("memory bank codes: two objects share one code")
        lengths = np.linalg.norm(self.features.astype(np.float64), axis=2)
        wrong = ~(np.abs(lengths - self.present) <= UNIT_TOLERANCE)
        if wrong.any():
            row, view = np.argwhere(wrong)[0]
            raise InputError(
                f"memory bank features: object {self.ids[row]} in view {view} has length "
                f"{lengths[row, view]:.4g}, expected {float(self.present[row, view]):g}"
            )

        if self.boxes is not None:
            size = self.boxes[..., 2:] - self.boxes[..., :2]
            shown = (size > 0).all(-1) & (self.boxes >= 0).all(-1)
            wrong = np.where(self.present, ~shown, self.boxes.any(-1))
            if wrong.any():
                row, view = np.argwhere(wrong)[0]
                raise InputError(
                    f"memory bank boxes: that of object {self.ids[row]} in view {view} is "
                    f"{self.boxes[row, view].tolist()}, expected columns and rows from and to, or "
                    "zeros if absent"
                )

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def dimension(self) -> int:
        """Numbers a code; 0 where there are no codes."""
        return self.codes.shape[1] if self.codes.ndim == 2 else 0

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name, as stored in ``bank.npz``: features as float16, boxes if known."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays["features"] = self.features.astype(np.float16)
        return {name: array for name, array in arrays.items() if array is not None}

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray]) -> MemoryBank:
        """Inverse of :meth:`to_arrays`."""
        return MemoryBank(**{**arrays, "features": np.asarray(arrays["features"], np.float32)})


def build_bank(
    views: Sequence[View],
    label_maps: LabelMaps,
    encoder: Encoder,
    codes: np.ndarray,
    names: Mapping[int, str] | None = None,
    surroundings: Sequence[Surroundings] | None = None,
) -> MemoryBank:
    """Encode every object in every view that holds it.

    Parameters
    ----------
    views : sequence of V View
        The photographs that the label maps belong to, in the same order.
    label_maps : LabelMaps
        labels [V, H, W].
    encoder : Encoder
    codes : float32 [N, D]
        One code for each of ``label_maps.ids``, in that order.
    names : {id: str}, optional
        For experiments, what the objects are called: an oracle, whose features are those of the
        names as texts, the same in all views. An object without a name is absent from all.
    surroundings : sequence of V Surroundings, optional
        Where the pixels of each view lie in the room, for encoders that make use of it.

    Raises
    ------
    InputError
        If views, label maps and codes do not match, there is no object at all, or the encoder
        cannot use a name.
    """
    ids = label_maps.ids
    if len(ids) == 0:
        raise InputError("memory bank: the label maps hold no object; nothing could be queried")
    sizes = [view.image.shape[:2] for view in views]
    if sizes != [labels.shape for labels in label_maps.labels]:
        raise InputError(
            f"memory bank: views are {sizes} and label maps {label_maps.labels.shape}, expected "
            "one map of the same size for each view"
        )
    if len(codes) != len(ids):
        raise InputError(f"memory bank: found {len(codes)} codes for {len(ids)} objects")
    present = label_maps.areas() > 0
    if names is not None:
        present &= np.isin(ids, list(names))[:, None]
    if surroundings is None:
        surroundings = [None] * len(views)
    columns, boxes = [], np.zeros((*present.shape, 4), np.int32)
    of_views = zip(views, label_maps.labels, present.T, surroundings, strict=True)
    for v, (view, labels, held, around) in enumerate(of_views):
        masks = labels == ids[held][:, None, None]
        if names is None:
            encoded = encoder.encode_regions(view.image, masks, around)
        else:
            encoded = encoder.encode_text([names[i] for i in ids[held].tolist()])
        column = np.zeros((len(ids), encoded.shape[1]), np.float32)
        column[held] = encoded
        columns.append(column.astype(np.float16).astype(np.float32))
        boxes[held, v] = _boxes(masks)
    return MemoryBank(ids, np.asarray(codes, np.float32), np.stack(columns, 1), present, boxes)


def merge(first: MemoryBank, later: MemoryBank) -> MemoryBank:
    """One bank of two: what more views say about the same objects, and about new ones.

    An id is the same object in both. The views of ``later`` come after those of ``first``; an
    object that is in one bank only is absent from the views of the other. An object keeps its code,
    so label the later views with the ids there are and give new objects codes that are still free.
    For scenes that share no object, give those of one of them other ids and codes first
    (``dataclasses.replace``). Without codes Gaussians carry rows of the bank, so that new objects
    need ids above all of ``first``.

    Raises
    ------
    InputError
        If the banks are of different encoders, an object has two codes, two objects share one, or
        rows would move.
    """
    widths = first.features.shape[2], later.features.shape[2]
    if widths[0] != widths[1] or first.codes.shape[1] != later.codes.shape[1]:
        raise InputError(
            f"merge of banks: features are {widths[0]} and {widths[1]} wide, codes "
            f"{first.codes.shape[1]} and {later.codes.shape[1]}, expected those of one encoder and "
            "one code strategy"
        )
    ids = np.union1d(first.ids, later.ids)
    places = [np.searchsorted(ids, bank.ids) for bank in (first, later)]
    codes = np.zeros((len(ids), first.codes.shape[1]), np.float32)
    for bank, place in zip((later, first), places[::-1], strict=True):
        codes[place] = bank.codes
    moved = (codes[places[1]] != later.codes).any(1)
    if moved.any():
        raise InputError(
            f"merge of banks: object {later.ids[moved][0]} has another code in each, expected one"
        )

    if first.dimension == 0 and not np.array_equal(ids[: len(first)], first.ids):
        raise InputError(
            f"merge of banks: without codes new objects need ids above {first.ids[-1]}, found "
            f"{np.setdiff1d(later.ids, first.ids)[0]}"
        )

    def beside(name: str) -> np.ndarray:
        columns = []
        for bank, place in zip((first, later), places, strict=True):
            own = getattr(bank, name)
            column = np.zeros((len(ids), *own.shape[1:]), own.dtype)
            column[place] = own
            columns.append(column)
        return np.concatenate(columns, 1)

    known = first.boxes is not None and later.boxes is not None
    boxes = beside("boxes") if known else None
    return MemoryBank(ids, codes, beside("features"), beside("present"), boxes)


def _boxes(masks: np.ndarray) -> np.ndarray:
    """First column and row, and those after the last, of masks bool [M, H, W] not empty."""
    found = np.empty((len(masks), 4), np.int32)
    for k, axis in enumerate((1, 2)):
        used = masks.any(axis)
        found[:, k] = used.argmax(1)
        found[:, 2 + k] = used.shape[1] - used[:, ::-1].argmax(1)
    return found
