"""An image of object ids made ready for questions."""

from __future__ import annotations

import numba
import numpy as np

from slgaussian.errors import InputError
from slgaussian.language.locate import central_point


class ObjectMap:
    """Which object of a bank each pixel shows, and what no text changes about that.

    Parameters
    ----------
    ids_map : int [H, W]
        Object id of each pixel, 0 where none.
    ids : int32 [N]
        The ids there are, positive and ascending: those of the bank.

    Attributes
    ----------
    rows : uint16 or int32 [H, W]
        1 + the place of the pixel's object in ``ids``, 0 where none.
    areas : int64 [N]
        Pixels of each object.

    Raises
    ------
    InputError
        If the map is no image of whole numbers, or holds an id that is not in ``ids``.
    """

    def __init__(self, ids_map: np.ndarray, ids: np.ndarray) -> None:
        if ids_map.ndim != 2 or not np.issubdtype(ids_map.dtype, np.integer):
            raise InputError(
                f"id map: found {ids_map.dtype} {ids_map.shape}, expected int32 [H, W]"
            )
        self.rows = np.empty(ids_map.shape, np.uint16 if len(ids) < 2**16 else np.int32)
        areas = np.zeros(len(ids) + 1, np.int64)
        ids_map = ids_map.astype(np.int32 if np.can_cast(ids_map.dtype, np.int32) else np.int64)
        strange = _look_up(ids_map.ravel(), ids, self.rows.ravel(), areas)
        if strange < 0:
            raise InputError(f"id map: found the negative id {strange}")
        if strange:
            raise InputError(f"id map: object {strange} is not in the memory bank")
        self.areas = areas[1:]
        self._points: dict[int, tuple[int, int]] = {}

    def spread(self, values: np.ndarray, nothing: object = 0) -> np.ndarray:
        """An image [H, W] with each object's value of ``values`` [N], ``nothing`` where none is."""
        table = np.concatenate([np.array([nothing], values.dtype), values])
        image = np.empty(self.rows.shape, values.dtype)
        _spread(table, self.rows.ravel(), image.ravel())
        return image

    def areas_within(self, mask: np.ndarray) -> np.ndarray:
        """Pixels of each object in a mask bool [H, W]: int64 [N]."""
        return np.bincount(self.rows[mask], minlength=len(self.areas) + 1)[1:]

    def point(self, place: int) -> tuple[int, int]:
        """The :func:`central_point` (x, y) of the visible object number ``place`` of ``ids``."""
        if place not in self._points:
            self._points[place] = central_point(self.rows == place + 1)
        return self._points[place]


@numba.njit(cache=True)
def _look_up(ids_map: np.ndarray, ids: np.ndarray, rows: np.ndarray, areas: np.ndarray) -> int:
    """Fill ``rows`` and ``areas`` (from 0, none); the first id that is not there, or 0.

    Neighbours mostly show the same object, so an id is searched for only where it changes.
    """
    last, row = np.int64(0), 0
    for i in range(len(ids_map)):
        if ids_map[i] != last:
            last = ids_map[i]
            row = 0
            if last != 0:
                row = 1 + np.searchsorted(ids, last)
                if row > len(ids) or ids[row - 1] != last:
                    return last
        rows[i] = row
        areas[row] += 1
    return 0


@numba.njit(cache=True)
def _spread(table: np.ndarray, rows: np.ndarray, image: np.ndarray) -> None:
    for i in range(len(rows)):
        image[i] = table[rows[i]]
