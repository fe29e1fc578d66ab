"""An image of object ids, with derived quantities that queries share."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from slgaussian.errors import InputError


class ObjectMap:
    """The object of each pixel, as rows of a bank, and quantities that depend on no text.

    Args:
        ids_map: int [H, W]. Object id of each pixel, 0 for none.
        ids: int32 [N]. Ids of the bank, positive and ascending.
        areas: int64 [N], optional. Number of pixels to assume for each object.

    Attributes:
        rows: uint8, uint16 or int32 [H, W]. 1 + the row of the pixel's object in ``ids``, 0 for
            none.
        areas: int64 [N]. Number of pixels of each object.

    Raises:
        InputError: If the map is not an integer image, or holds an id that is not in ``ids``.
    """

    def __init__(
        self, ids_map: np.ndarray, ids: np.ndarray, areas: np.ndarray | None = None
    ) -> None:
        if ids_map.ndim != 2 or not np.issubdtype(ids_map.dtype, np.integer):
            raise InputError(
                f"id map: found {ids_map.dtype} {ids_map.shape}, expected int32 [H, W]"
            )
        self.rows = _look_up(ids_map, ids)
        counts = np.bincount(self.rows.ravel(), minlength=len(ids) + 1)[1:]
        self.areas = counts if areas is None else areas
        self._points: dict[int, tuple[int, int]] = {}

    @cached_property
    def _index(self) -> np.ndarray:
        """:attr:`rows` in NumPy's index type."""
        return self.rows.astype(np.intp)

    def spread(self, values: np.ndarray, nothing: object = 0) -> np.ndarray:
        """Map ``values`` [N] of objects to an image [H, W], with ``nothing`` where no object is."""
        table = np.concatenate([np.array([nothing], values.dtype), values])
        if self.rows.dtype == np.uint8 and table.itemsize in (1, 4):
            # OpenCV's lookup takes half the time; its table must have 256 entries.
            bits = np.resize(table, 256).view(np.uint8 if table.itemsize == 1 else np.float32)
            return cv2.LUT(self.rows, bits).view(table.dtype)
        return table.take(self._index)

    def areas_within(self, mask: np.ndarray) -> np.ndarray:
        """Count the pixels of each object in a mask bool [H, W]: int64 [N]."""
        return np.bincount(self.rows[mask], minlength=len(self.areas) + 1)[1:]

    @cached_property
    def touching(self) -> np.ndarray:
        """Rows int64 [E, 2] of objects with a common border (4-connected), each pair once.

        The lower row comes first.
        """
        base, rows = len(self.areas) + 1, self.rows
        borders = []
        for first, second in ((rows[:, :-1], rows[:, 1:]), (rows[:-1], rows[1:])):
            border = (first != second) & (first > 0) & (second > 0)
            a, b = first[border].astype(np.int64), second[border].astype(np.int64)
            borders.append(np.minimum(a, b) * base + np.maximum(a, b))
        return np.stack(np.divmod(np.unique(np.concatenate(borders)), base), 1) - 1

    def parts(self, selected: np.ndarray) -> int:
        """Count the connected groups of the visible objects among ``selected`` bool [N]."""
        visible = selected & (self.areas > 0)
        group = {row: {row} for row in np.flatnonzero(visible).tolist()}
        for a, b in self.touching[visible[self.touching].all(1)].tolist():
            if group[a] is not group[b]:
                group[a] |= group[b]
                group |= dict.fromkeys(group[b], group[a])
        return len({id(members) for members in group.values()})

    def point(self, place: int) -> tuple[int, int]:
        """Return the :func:`central_point` (x, y) of the visible object in row ``place``."""
        if place not in self._points:
            self._points[place] = central_point(self.rows == place + 1)
        return self._points[place]


def _look_up(ids_map: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Convert ids to rows [H, W], 1 + the index in ``ids``; InputError for an id not in it.

    Only the first pixel of each run of equal ids is searched for.
    """
    flat = ids_map.ravel()
    starts = np.flatnonzero(np.concatenate([[len(flat) > 0], flat[1:] != flat[:-1]]))
    run_ids = flat[starts]
    places = np.searchsorted(ids, run_ids)
    strange = run_ids[(run_ids != 0) & (np.append(ids, 0)[places] != run_ids)]
    if len(strange):
        if strange[0] < 0:
            raise InputError(f"id map: found the negative id {strange[0]}")
        raise InputError(f"id map: object {strange[0]} is not in the memory bank")
    rows = np.where(run_ids == 0, 0, places + 1)
    rows = rows.astype(np.min_scalar_type(len(ids)) if len(ids) < 2**16 else np.int32)
    return np.repeat(rows, np.diff(starts, append=len(flat))).reshape(ids_map.shape)


def central_point(region: np.ndarray) -> tuple[int, int]:
    """Find the pixel (x, y) = (column, row) of a region that is farthest from its outside.

    It lies in the largest 4-connected component of the bool [H, W] mask and has the largest
    Euclidean distance to the nearest pixel outside, pixels beyond the image included. Distances
    are float32, and any of several equal ones may be taken.
    """
    x, y, w, h = cv2.boundingRect(region.view(np.uint8))
    mask = np.ascontiguousarray(region[y : y + h, x : x + w]).view(np.uint8)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4, ltype=cv2.CV_32S)
    largest = 1 + stats[1:, cv2.CC_STAT_AREA].argmax()
    left, top, width, height, _ = stats[largest].tolist()
    part = parts[top : top + height, left : left + width] == largest
    inside = np.pad(part.view(np.uint8), 1)
    depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    row, column = np.unravel_index(depth.argmax(), depth.shape)
    return x + left + int(column) - 1, y + top + int(row) - 1
