"""Texture features that distinguish plain, striped, checked, dotted and grainy surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

_OUTLINE_MARGIN = 2  # pixels excluded along the outline, which mix with neighbouring regions
_MIN_HOLE_RADIUS = 0.25  # of a ring, relative to the RMS distance from its centre


@dataclass(frozen=True)
class Pattern:
    """Features of one surface; all except ``roughness`` are independent of scale.

    Attributes:
        roughness: Mean CIELAB gradient, units per pixel of the crop.
        two_tone: Fraction of the colour variance explained by two clusters, in [0, 1].
        contrast: CIELAB distance between the two clusters.
        minor: Fraction of pixels in the smaller cluster, in [0, 0.5].
        along: Second harmonic of the gradient directions, in [0, 1]: 1 if all edges are parallel.
            On a ring, directions of ``along`` and ``crossed`` are relative to the radius.
        crossed: Fourth harmonic, in [0, 1]: 1 if all edges are parallel or at right angles.
        upright: In [-1, 1]: 1 if all edges are vertical, -1 if all are horizontal.
        spots: Number of connected components of the smaller cluster.
        spot_fill: Area of the components relative to ellipses with the same second moments, mean
            weighted by area; near 1 for discs, lower for ragged and branching components.
    """

    roughness: float
    two_tone: float
    contrast: float
    minor: float
    along: float
    crossed: float
    upright: float
    spots: float
    spot_fill: float


def measure(lab: np.ndarray, mask: np.ndarray) -> Pattern:
    """Measure the surface of ``mask`` bool [h, w] in CIELAB float32 [h, w, 3]."""
    kernel = cv2.getStructuringElement(
        cv2.MORPH_RECT, (2 * _OUTLINE_MARGIN + 1, 2 * _OUTLINE_MARGIN + 1)
    )
    inside = cv2.erode(np.pad(mask, 1).view(np.uint8), kernel)[1:-1, 1:-1].view(bool)
    if np.count_nonzero(inside) < 16:
        inside = mask
    along, crossed, upright, roughness = _directions(lab, inside, _radial_rotation(mask))
    two_tone, contrast, second = _two_tones(lab, inside)
    minor = np.count_nonzero(second) / np.count_nonzero(inside)
    spots, fill = _spots(second)
    return Pattern(roughness, two_tone, contrast, minor, along, crossed, upright, spots, fill)


def _radial_rotation(mask: np.ndarray) -> np.ndarray | None:
    """Compute complex factors [h, w] that rotate doubled directions to be relative to the radius.

    Only for rings, whose pattern follows the hole; None if the centre is not an enclosed hole.
    """
    y, x = (
        np.arange(len(count)) - (count @ np.arange(len(count))) / count.sum()
        for count in (np.count_nonzero(mask, axis=1), np.count_nonzero(mask, axis=0))
    )
    y = y[:, None]
    spread = np.hypot(x, y)
    distances = spread[mask]
    if distances.min() < _MIN_HOLE_RADIUS * np.sqrt((distances**2).mean()):
        return None
    empty = np.pad(~mask, 1, constant_values=True).view(np.uint8)
    _, holes = cv2.connectedComponents(empty, connectivity=4)
    centre = np.unravel_index(spread.argmin(), mask.shape)
    if holes[1:-1, 1:-1][centre] == holes[0, 0]:
        return None
    return ((x - 1j * y) / np.maximum(spread, 1e-9)) ** 2


def _directions(
    lab: np.ndarray, inside: np.ndarray, around: np.ndarray | None
) -> tuple[float, float, float, float]:
    smooth = cv2.GaussianBlur(lab, (0, 0), 0.8)
    gx = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 32)[inside]
    gy = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 32)[inside]
    xx, yy, xy = _dot(gx, gx), _dot(gy, gy), _dot(gx, gy)
    energy = xx + yy
    total = float(energy.sum()) + 1e-6
    double = (xx - yy) + 2j * xy
    upright = float(double.real.sum()) / total
    if around is not None:
        double = double * around[inside]
    unit = double / (np.abs(double) + 1e-6)
    along = abs(complex(double.sum())) / total
    crossed = abs(complex((np.abs(double) * unit * unit).sum())) / total
    return along, crossed, upright, float(np.sqrt(energy).mean())


def _two_tones(lab: np.ndarray, inside: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Split colours along their main axis by Otsu's method.

    Returns the explained fraction of the variance, the distance and the smaller cluster.
    """
    colours = lab[inside].astype(np.float64)
    centred = colours - colours.mean(0)
    spread = np.einsum("nc,nd->cd", centred, centred)
    axis = _dot(centred, np.linalg.eigh(spread)[1][:, -1])
    low, high = axis.min(), axis.max()
    bins = np.minimum((axis - low) / max(high - low, 1e-9) * 128, 127).astype(int)
    weight = np.bincount(bins, minlength=128).cumsum() / len(axis)
    moment = np.bincount(bins, axis, minlength=128).cumsum() / len(axis)
    between = moment**2 / np.maximum(weight * (1 - weight), 1e-9)
    upper = bins > between[:-1].argmax()
    if upper.all() or not upper.any():
        return 0.0, 0.0, np.zeros_like(inside)
    difference = centred[upper].mean(0) - centred[~upper].mean(0)
    share = np.count_nonzero(upper) / len(upper)
    explained = share * (1 - share) * (difference @ difference) * len(axis) / np.trace(spread)
    second = np.zeros_like(inside)
    second[inside] = upper if share <= 0.5 else ~upper
    return float(explained), float(np.sqrt(difference @ difference)), second


def _spots(second: np.ndarray) -> tuple[float, float]:
    count, labels = cv2.connectedComponents(second.view(np.uint8), connectivity=4)
    if count == 1:
        return 0.0, 0.0
    rows, cols = np.nonzero(labels)
    piece = labels[rows, cols]
    area = np.bincount(piece, minlength=count)[1:].astype(float)
    x = np.bincount(piece, cols, count)[1:] / area
    y = np.bincount(piece, rows, count)[1:] / area
    dx, dy = cols - x[piece - 1], rows - y[piece - 1]
    # A pixel is a unit square, which adds 1/12 to a variance.
    xx = np.bincount(piece, dx * dx, count)[1:] / area + 1 / 12
    yy = np.bincount(piece, dy * dy, count)[1:] / area + 1 / 12
    xy = np.bincount(piece, dx * dy, count)[1:] / area
    fill = area / (4 * np.pi * np.sqrt(np.maximum(xx * yy - xy * xy, 1e-9)))
    share = area / area.sum()
    return float((share > 0.01).sum()), float(share @ fill)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute dot products along the last axis, [..., 3]."""
    product: np.ndarray = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return product
