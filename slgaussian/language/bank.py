"""The multi-view language memory bank: for each ID code, what every view says about the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language import Encoder
from slgaussian.scene import View

UNIT_TOLERANCE = 1e-3
"""Largest allowed | |L| - 1 |: half-precision features pass, features never normalised do not."""


@dataclass(frozen=True, eq=False)
class MemoryBank:
    """``{ID: {L_1 ... L_V}}`` of section 3.2, as arrays over N objects.

    The paper writes a zero vector where a view does not hold the object; a zero vector would score
    0.5 against everything, so here such a view is marked absent and never scored.

    Attributes
    ----------
    ids : int32 [N]
        Object ids as in the label maps, positive and ascending.
    codes : float32 [N, 3]
        ID codes in [0, 1], all different.
    features : float32 [N, V, C]
        Unit vectors of the encoder that built the bank; zero where absent.
    present : bool [N, V]
        Which views hold the object.

    Raises
    ------
    InputError
        If any of this does not hold; the message names the array and the object.
    """

    ids: np.ndarray
    codes: np.ndarray
    features: np.ndarray
    present: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.ids)
        views, width = self.features.shape[1:] if self.features.ndim == 3 else (0, 0)
        expected = {
            "ids": ("int32", (n,)),
            "codes": ("float32", (n, 3)),
            "features": ("float32", (n, views, width)),
            "present": ("bool", (n, views)),
        }
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
        if len(np.unique(self.codes, axis=0)) != n:
            raise InputError("memory bank codes: two objects share one code")
        lengths = np.linalg.norm(self.features.astype(np.float64), axis=2)
        wrong = ~(np.abs(lengths - self.present) <= UNIT_TOLERANCE)
        if wrong.any():
            row, view = np.argwhere(wrong)[0]
            raise InputError(
                f"memory bank features: object {self.ids[row]} in view {view} has length "
                f"{lengths[row, view]:.4g}, expected {float(self.present[row, view]):g}"
            )

    def __len__(self) -> int:
        return len(self.ids)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name, as stored in ``bank.npz``."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray]) -> MemoryBank:
        """Inverse of :meth:`to_arrays`."""
        return MemoryBank(**{f.name: np.asarray(arrays[f.name]) for f in fields(MemoryBank)})


def build_bank(
    views: Sequence[View], label_maps: LabelMaps, encoder: Encoder, codes: np.ndarray
) -> MemoryBank:
    """Encode every object in every view that holds it.

    Parameters
    ----------
    views : sequence of V View
        The photographs that the label maps belong to, in the same order.
    label_maps : LabelMaps
        labels [V, H, W].
    encoder : Encoder
    codes : float32 [N, 3]
        One code for each of ``label_maps.ids``, in that order.

    Raises
    ------
    InputError
        If views, label maps and codes do not match, or there is no object at all.
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
    columns = []
    for view, labels, held in zip(views, label_maps.labels, present.T, strict=True):
        masks = labels == ids[held][:, None, None]
        encoded = encoder.encode_regions(view.image, masks)
        column = np.zeros((len(ids), encoded.shape[1]), np.float32)
        column[held] = encoded
        columns.append(column)
    return MemoryBank(ids, np.asarray(codes, np.float32), np.stack(columns, 1), present)
