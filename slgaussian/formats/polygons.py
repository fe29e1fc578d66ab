"""Polygons of masks, and masks of polygons, with pixel centres at +0.5."""

from __future__ import annotations

import cv2
import numpy as np


def fill_polygon(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """Draw a polygon float64 [n, 2] of x, y in pixels as bool [height, width].

    A pixel is set if its centre, at +0.5, is inside by the even-odd rule. pycocotools rounds points
    to fifths of a pixel first, and may differ by pixels that the outline crosses.
    """
    (x0, y0), (x1, y1) = points.T, np.roll(points, -1, axis=0).T
    ends = np.sort(np.ceil(np.stack([y0, y1]) - 0.5).clip(0, height).astype(np.int64), axis=0)
    counts = ends[1] - ends[0]
    edge = np.repeat(np.arange(len(points)), counts)
    rows = np.arange(len(edge)) - np.repeat(counts.cumsum() - counts, counts) + ends[0][edge]
    slope = (x1 - x0)[edge] / (y1 - y0)[edge]
    crossings = x0[edge] + (rows + 0.5 - y0[edge]) * slope
    columns = np.ceil(crossings - 0.5).clip(0, width).astype(np.int64)
    passed = np.bincount(rows * (width + 1) + columns, minlength=height * (width + 1))
    return passed.reshape(height, -1).cumsum(1)[:, :width] % 2 == 1


def trace_polygons(mask: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """Trace the outline of each connected piece of a mask.

    A hole is joined to the outline by a seam that is passed in both directions, so that it stays
    empty where polygons can have no holes, as in COCO.

    Args:
        mask: bool [H, W], not empty.
        tolerance: Largest distance of left out points from the polygon, pixels.

    Returns:
        list of float64 [n, 2]: x, y in pixels, n at least 3.
    """
    from skimage.measure import find_contours, label, regionprops

    polygons = []
    for piece in regionprops(label(mask, connectivity=1)):
        rings = []
        for contour in find_contours(np.pad(piece.image, 1), 0.5):
            ring = contour[:-1, ::-1] - 0.5 + (piece.bbox[1], piece.bbox[0])
            fewer = cv2.approxPolyDP(ring[:, None].astype(np.float32), tolerance, True)[:, 0]
            rings.append(fewer.astype(np.float64) if len(fewer) > 2 else ring)
        outline, *holes = sorted(rings, key=lambda ring: -np.ptp(ring, axis=0).prod())
        for hole in holes:
            distances = np.linalg.norm(outline[:, None] - hole, axis=-1)
            at, to = np.unravel_index(distances.argmin(), distances.shape)
            there = np.concatenate([hole[to:], hole[: to + 1]])
            outline = np.concatenate([outline[: at + 1], there, outline[at:]])
        polygons.append(outline)
    return polygons
