"""Resampling of photographs, masks, ids and depth maps.

Photographs are averaged over the area of each new pixel; a mask is set where it covers more than
half of the new pixel; ids and depths are sampled at its centre. All are resampled by the same
:class:`Window`, so ground truth stays aligned with its photograph, whatever its resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from slgaussian.errors import InputError

if TYPE_CHECKING:  # queries must not wait for the import of SciPy
    from scipy.sparse import csr_array

MAX_ASPECT_DIFFERENCE = 0.01
"""Largest relative difference in aspect ratio of two images of one photograph."""

SAME_SURFACE = 0.01
"""Relative difference of inverse depths up to which neighbours are on one surface; a larger one
must continue to the next pixels, as on a plane at a grazing angle."""


@dataclass(frozen=True)
class Fit:
    """An image scaled to cover a size, then cropped about the centre.

    Attributes:
        full_width, full_height: Size of the scaled image, pixels.
        left, top, width, height: Crop, pixels of the scaled image.
    """

    full_width: int
    full_height: int
    left: int
    top: int
    width: int
    height: int

    @staticmethod
    def cover(image_width: int, image_height: int, width: int, height: int) -> Fit:
        """Fit an image of the given size to ``width`` x ``height`` pixels."""
        scale = max(height / image_height, width / image_width)
        full_width = max(width, round(image_width * scale))
        full_height = max(height, round(image_height * scale))
        left, top = (full_width - width) // 2, (full_height - height) // 2
        return Fit(full_width, full_height, left, top, width, height)

    def photograph(self, image: np.ndarray) -> np.ndarray:
        """Resample a photograph uint8 [H, W, C]: area average if it shrinks, else bilinear."""
        shrinks = self.full_width * self.full_height < image.shape[0] * image.shape[1]
        interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        full = cv2.resize(image, (self.full_width, self.full_height), interpolation=interpolation)
        rows, columns = self.top + self.height, self.left + self.width
        return np.ascontiguousarray(full[self.top : rows, self.left : columns])


@dataclass(frozen=True)
class Window:
    """Part of a photograph that a view shows.

    Attributes:
        photo_width, photo_height: Size of the whole photograph, pixels.
        left, top, right, bottom: Edges of the part, pixels of the photograph from its top-left
            corner.
    """

    photo_width: int
    photo_height: int
    left: float
    top: float
    right: float
    bottom: float

    @staticmethod
    def whole(width: int, height: int) -> Window:
        """Return the window of a full photograph of ``width`` x ``height`` pixels."""
        return Window(width, height, 0.0, 0.0, float(width), float(height))

    @staticmethod
    def covering(image_width: int, image_height: int, width: int, height: int) -> Window:
        """Return the window of a view of ``width`` x ``height`` to which an image is fitted."""
        fit = Fit.cover(image_width, image_height, width, height)
        return Window.whole(image_width, image_height).crop(fit)

    def crop(self, fit: Fit) -> Window:
        """Return the window of a view that results from applying ``fit`` to this view."""
        x, y = (self.right - self.left) / fit.full_width, (self.bottom - self.top) / fit.full_height
        left, top = self.left + x * fit.left, self.top + y * fit.top
        right, bottom = left + x * fit.width, top + y * fit.height
        return Window(self.photo_width, self.photo_height, left, top, right, bottom)

    def has_shape(self, width: int, height: int) -> bool:
        """Tell whether ``width`` x ``height`` has the photograph's aspect ratio.

        The tolerance is :data:`MAX_ASPECT_DIFFERENCE` or, if larger, the rounding of the smaller
        image.
        """
        a, b = width * self.photo_height, height * self.photo_width
        smaller = min(width + height, self.photo_width + self.photo_height)
        rounding = (width + height) * (self.photo_width + self.photo_height) / smaller / 2
        return abs(a - b) <= max(MAX_ASPECT_DIFFERENCE * min(a, b), rounding)

    def check_shape(self, name: object, width: int, height: int) -> None:
        """Raise InputError with the name if an image has another aspect than the photograph."""
        if not self.has_shape(width, height):
            raise InputError(
                f"{name}: is {width}x{height}, of another shape than its photograph, "
                f"{self.photo_width}x{self.photo_height}; check that it is not turned or cropped"
            )

    def mask(self, mask: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample a mask bool [H, W] of the whole photograph to bool [height, width].

        A pixel is set if more than half of it is covered.
        """
        (y0, y1), (x0, x1) = self._ends(mask.shape)
        rows = _overlap(mask.shape[0], y0, y1, height)
        columns = _overlap(mask.shape[1], x0, x1, width)
        cover = (rows @ mask.astype(np.float32)) @ columns.T
        return cover > 0.5 + 1e-5  # exactly half covered means unset, despite rounding

    def ids(self, ids: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample ids [H, W] of the whole photograph at the pixel centres (nearest)."""
        x, y = self._centres(ids.shape, height, width)
        rows, columns = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
        return ids[np.ix_(rows.clip(0, len(ids) - 1), columns.clip(0, ids.shape[1] - 1))]

    def spread_ids(self, ids: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample ids [H, W] of the view to the whole photograph at ``height`` x ``width`` pixels.

        It is the inverse of :meth:`ids` where the view has no more pixels than its part of the
        photograph. What the view does not show is 0.
        """
        (y0, y1), (x0, x1) = self._ends((height, width))
        rows = np.floor((np.arange(height) + 0.5 - y0) / (y1 - y0) * ids.shape[0])
        columns = np.floor((np.arange(width) + 0.5 - x0) / (x1 - x0) * ids.shape[1])
        y, x = rows.clip(-1, ids.shape[0]), columns.clip(-1, ids.shape[1])
        return np.pad(ids, 1)[np.ix_(y.astype(np.int64) + 1, x.astype(np.int64) + 1)]

    def depth(self, depth: np.ndarray, height: int, width: int) -> np.ndarray:
        """Resample z-depth float32 [H, W] of the whole photograph by :func:`sample_depth`."""
        x, y = self._centres(depth.shape, height, width)
        return sample_depth(depth, x[None], y[:, None])

    def boxes(self, boxes: np.ndarray, shape: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
        """Map boxes float64 [n, 4] (x0, y0, x1, y1) from pixels of an image of the whole photograph
        with ``shape`` (height, width) to pixels of the view with ``size``."""
        (y0, y1), (x0, x1) = self._ends(shape)
        corners = boxes.reshape(-1, 2, 2) - (x0, y0)
        return (corners * (size[1] / (x1 - x0), size[0] / (y1 - y0))).reshape(-1, 4)

    def _ends(self, shape: tuple[int, ...]) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the first and last row and column edge, pixels of an image of ``shape``."""
        y, x = shape[0] / self.photo_height, shape[1] / self.photo_width
        return (self.top * y, self.bottom * y), (self.left * x, self.right * x)

    def _centres(
        self, shape: tuple[int, ...], height: int, width: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return columns float64 [width] and rows [height] of the view's pixel centres in an image
        of the photograph, from its corner."""
        (y0, y1), (x0, x1) = self._ends(shape)
        x = x0 + (x1 - x0) * (np.arange(width) + 0.5) / width
        return x, y0 + (y1 - y0) * (np.arange(height) + 0.5) / height


def sample_depth(depth: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Sample a depth map at points.

    The inverse depth of the containing pixel is extrapolated along each axis with the slope to the
    neighbour on that side, or from the opposite neighbour, if both are on one surface. Inverse
    depth is affine on a plane, so planes are exact. Nothing is interpolated across depth steps and
    holes.

    Args:
        depth: float32 [H, W]. z-depth, 0 where unknown.
        x, y: float [...]. Columns and rows from the top-left corner, pixel centres at +0.5;
            broadcast together.

    Returns:
        float32 [...]: 0 where the pixel is unknown or the point outside.
    """
    height, width = depth.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = np.where(inside, x, 0).astype(np.float64), np.where(inside, y, 0).astype(np.float64)
    column, row = x.astype(np.int64), y.astype(np.int64)
    valid = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=valid)
    nearest = inverse[row, column]
    value = nearest.copy()
    for offset, slopes in (
        (x - column - 0.5, _slopes(inverse, valid)),
        (y - row - 0.5, [slope.T for slope in _slopes(inverse.T, valid.T)]),
    ):
        behind, ahead = (slope[row, column] for slope in slopes)
        value += offset * np.where(offset < 0, behind, ahead)
    # If half a pixel reaches half way to the horizon, the slope is not reliable.
    value = np.where(value > nearest / 2, value, nearest)
    out = np.zeros(value.shape)
    return np.divide(1.0, value, out=out, where=inside & (nearest > 0)).astype(np.float32)


def _slopes(inverse: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute slopes of inverse depth [H, W] along rows, to the left and right of each pixel.

    If one neighbour is on another surface, the slope of the other side is used; if both are, 0.
    """
    step = np.diff(inverse, axis=1)
    pair = valid[:, :-1] & valid[:, 1:]
    tolerance = SAME_SURFACE * np.minimum(inverse[:, :-1], inverse[:, 1:])
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
    """Compute the fraction of each of ``new`` pixels, spread over ``start`` to ``stop``, that each
    of ``old`` pixels covers: float32 [new, old]."""
    from scipy.sparse import csr_array

    edges = start + (stop - start) * np.arange(new + 1) / new
    cuts = np.union1d(edges, np.arange(np.ceil(start), np.floor(stop) + 1))
    middle = (cuts[:-1] + cuts[1:]) / 2
    rows = np.clip(np.searchsorted(edges, middle) - 1, 0, new - 1)
    columns = np.clip(np.floor(middle), 0, old - 1).astype(np.int64)
    shares = np.diff(cuts) * new / (stop - start)
    return csr_array((shares.astype(np.float32), (rows, columns)), shape=(new, old))
