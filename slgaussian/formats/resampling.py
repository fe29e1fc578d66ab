"""Resampling of photographs and of what belongs to their pixels: one rule, one place.

Photographs are averaged over the area of each new pixel; a mask holds where it covers more than
half of the new pixel; ids and depths are those at its centre. All of them move by one
:class:`Window`, so that a truth stays on what it was drawn on, whatever its own size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from slgaussian.errors import InputError

if TYPE_CHECKING:  # a question waits for no SciPy
    from scipy.sparse import csr_array

MOST_ASPECT = 0.01
"""Relative difference of aspect up to which two images can be of one photograph."""

LEAST_STEP = 0.01
"""Relative difference of inverse depths of neighbours up to which they are on one surface; a larger
one has to go on beside them, as on a plane seen at a grazing angle."""


@dataclass(frozen=True)
class Fit:
    """An image scaled to cover a size, then cropped about the centre.

    Attributes
    ----------
    full_width, full_height : int
        Size that the whole image is scaled to, pixels.
    left, top, width, height : int
        Crop, pixels of the scaled image.
    """

    full_width: int
    full_height: int
    left: int
    top: int
    width: int
    height: int

    @staticmethod
    def cover(image_width: int, image_height: int, width: int, height: int) -> Fit:
        """Fit an image of a size to ``width`` x ``height`` pixels."""
        scale = max(height / image_height, width / image_width)
        full_width = max(width, round(image_width * scale))
        full_height = max(height, round(image_height * scale))
        left, top = (full_width - width) // 2, (full_height - height) // 2
        return Fit(full_width, full_height, left, top, width, height)

    def photograph(self, image: np.ndarray) -> np.ndarray:
        """Resample a photograph uint8 [H, W, C]: by area if it shrinks, else linearly."""
        shrinks = self.full_width * self.full_height < image.shape[0] * image.shape[1]
        how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        full = cv2.resize(image, (self.full_width, self.full_height), interpolation=how)
        rows, columns = self.top + self.height, self.left + self.width
        return np.ascontiguousarray(full[self.top : rows, self.left : columns])


@dataclass(frozen=True)
class Window:
    """Part of a photograph that a view shows.

    Attributes
    ----------
    photo_width, photo_height : int
        Size of the whole photograph, pixels.
    left, top, right, bottom : float
        Edges of the part, pixels of the photograph from its top-left corner.
    """

    photo_width: int
    photo_height: int
    left: float
    top: float
    right: float
    bottom: float

    @staticmethod
    def whole(width: int, height: int) -> Window:
        """Window that shows all of a photograph of ``width`` x ``height`` pixels."""
        return Window(width, height, 0.0, 0.0, float(width), float(height))

    @staticmethod
    def covering(image_width: int, image_height: int, width: int, height: int) -> Window:
        """Window of a view of ``width`` x ``height`` that an image is fitted to."""
        fit = Fit.cover(image_width, image_height, width, height)
        return Window.whole(image_width, image_height).cropped(fit)

    def cropped(self, fit: Fit) -> Window:
        """Window of a view that is made by ``fit`` of the view of this one."""
        x, y = (self.right - self.left) / fit.full_width, (self.bottom - self.top) / fit.full_height
        left, top = self.left + x * fit.left, self.top + y * fit.top
        right, bottom = left + x * fit.width, top + y * fit.height
        return Window(self.photo_width, self.photo_height, left, top, right, bottom)

    def has_shape(self, width: int, height: int) -> bool:
        """Tell whether ``width`` x ``height`` is the photograph's shape.

        To :data:`MOST_ASPECT`, or what rounding of the smaller to whole pixels makes of it.
        """
        a, b = width * self.photo_height, height * self.photo_width
        smaller = min(width + height, self.photo_width + self.photo_height)
        rounding = (width + height) * (self.photo_width + self.photo_height) / smaller / 2
        return abs(a - b) <= max(MOST_ASPECT * min(a, b), rounding)

    def check_shape(self, name: object, width: int, height: int) -> None:
        """Raise InputError, with the name, if an image has not the shape of the photograph."""
        if not self.has_shape(width, height):
            raise InputError(
                f"{name}: is {width}x{height}, of another shape than its photograph, "
                f"{self.photo_width}x{self.photo_height}; expected the same aspect to "
                f"{MOST_ASPECT:.0%}, so check that it belongs to it and is neither turned nor "
                "cropped"
            )

    def mask(self, mask: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample a mask bool [H, W] of the whole photograph to bool [height, width].

        A pixel is set if more than half of it is covered.
        """
        rows, columns = self._overlaps(mask.shape, height, width)
        cover = (rows @ mask.astype(np.float32)) @ columns.T
        return cover > 0.5 + 1e-5  # what is exactly half stays out, whatever the rounding

    def ids(self, ids: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample ids [H, W] of the whole photograph: those that the pixels' centres lie in."""
        x, y = self._centres(ids.shape, height, width)
        places = (
            np.clip(np.floor(at), 0, count - 1).astype(np.int64)
            for at, count in zip((y, x), ids.shape, strict=True)
        )
        return ids[np.ix_(*places)]

    def depth(self, depth: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample z-depth float32 [H, W] of the whole photograph by :func:`sample_depth`."""
        x, y = self._centres(depth.shape, height, width)
        return sample_depth(depth, x[None], y[:, None])

    def boxes(self, boxes: np.ndarray, shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
        """Boxes float64 [n, 4] (x0, y0, x1, y1) in pixels of an image of ``shape`` (height, width)
        of the whole photograph, in those of the view of ``size``."""
        (y0, y1), (x0, x1) = self._ends(shape)
        corners = boxes.reshape(-1, 2, 2) - (x0, y0)
        return (corners * (size[1] / (x1 - x0), size[0] / (y1 - y0))).reshape(-1, 4)

    def _ends(self, shape: tuple[int, ...]) -> tuple[tuple[float, float], tuple[float, float]]:
        """First and last row and column, as edges, in pixels of an image of the photograph."""
        y, x = shape[0] / self.photo_height, shape[1] / self.photo_width
        return (self.top * y, self.bottom * y), (self.left * x, self.right * x)

    def _centres(
        self, shape: tuple[int, ...], height: int, width: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns float64 [width] and rows [height] of the view's pixel centres in an image of the
        photograph, from its corner."""
        (y0, y1), (x0, x1) = self._ends(shape)
        x = x0 + (x1 - x0) * (np.arange(width) + 0.5) / width
        return x, y0 + (y1 - y0) * (np.arange(height) + 0.5) / height

    def _overlaps(
        self, shape: tuple[int, ...], height: int, width: int
    ) -> tuple[csr_array, csr_array]:
        rows, columns = self._ends(shape)
        return _overlap(shape[0], *rows, height), _overlap(shape[1], *columns, width)


def sample_depth(depth: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Sample a depth map at points.

    A point takes the inverse depth of the pixel that it lies in, continued along each axis by the
    slope towards the neighbour on its side, or away from the other, if they are on one surface:
    inverse depth is affine on a plane, so planes come out exactly. Across steps and holes nothing
    is mixed.

    Parameters
    ----------
    depth : float32 [H, W]
        z-depth, 0 where unknown.
    x, y : float [...]
        Columns and rows from the top-left corner, pixel centres at +0.5; broadcast together.

    Returns
    -------
    float32 [...]
        0 where the pixel is unknown or the point outside.
    """
    height, width = depth.shape
    x, y = np.broadcast_arrays(x, y)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = np.where(inside, x, 0).astype(np.float64), np.where(inside, y, 0).astype(np.float64)
    column, row = x.astype(np.int64), y.astype(np.int64)
    at = row, column
    valid = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=valid)
    nearest = inverse[at]
    value = nearest.copy()
    for offset, slopes in (
        (x - column - 0.5, _slopes(inverse, valid)),
        (y - row - 0.5, [slope.T for slope in _slopes(inverse.T, valid.T)]),
    ):
        behind, ahead = (slope[at] for slope in slopes)
        value += offset * np.where(offset < 0, behind, ahead)
    # Where half a pixel is half the way to the horizon, the slope says too little.
    value = np.where(value > nearest / 2, value, nearest)
    out = np.zeros(value.shape)
    return np.divide(1.0, value, out=out, where=inside & (nearest > 0)).astype(np.float32)


def _slopes(inverse: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of inverse depth [H, W] along rows, to the left and to the right of each pixel.

    Where the neighbour on one side is on another surface, that of the other side; else 0.
    """
    step = np.diff(inverse, axis=1)
    pair = valid[:, :-1] & valid[:, 1:]
    tolerance = LEAST_STEP * np.minimum(inverse[:, :-1], inverse[:, 1:])
    similar = np.abs(step) <= tolerance
    goes_on = np.abs(np.diff(step, axis=1)) <= 0.5 * np.minimum(
        np.abs(step[:, :-1]), np.abs(step[:, 1:])
    )
    goes_on &= pair[:, :-1] & pair[:, 1:]
    similar[:, 1:] |= goes_on
    similar[:, :-1] |= goes_on
    joined = np.pad(pair & similar, ((0, 0), (1, 1)))
    step = np.pad(step, ((0, 0), (1, 1)))
    step[~joined] = 0
    behind, ahead = step[:, :-1], step[:, 1:]
    return np.where(joined[:, :-1], behind, ahead), np.where(joined[:, 1:], ahead, behind)


def _overlap(old: int, start: float, stop: float, new: int) -> csr_array:
    """Share of each of ``new`` pixels, from ``start`` to ``stop``, that each of ``old`` covers:
    float32 [new, old]."""
    from scipy.sparse import csr_array

    edges = start + (stop - start) * np.arange(new + 1) / new
    cuts = np.union1d(edges, np.arange(np.ceil(start), np.floor(stop) + 1))
    middle = (cuts[:-1] + cuts[1:]) / 2
    rows = np.clip(np.searchsorted(edges, middle) - 1, 0, new - 1)
    columns = np.clip(np.floor(middle), 0, old - 1).astype(np.int64)
    shares = np.diff(cuts) * new / (stop - start)
    return csr_array((shares.astype(np.float32), (rows, columns)), shape=(new, old))
