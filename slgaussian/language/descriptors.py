"""Measurements of image regions: evidence for or against each descriptor.

Evidence lies in [-1, 1]: 1 for, -1 against, 0 undecided. Lengths are relative to the image or the
region, so that the resolution of a photograph has little influence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from slgaussian.geometry.room import Surroundings
from slgaussian.language import silhouettes
from slgaussian.language.colours import ColourNames, to_lab

SURFACES = (
    "light", "colourful", "shiny", "plain", "striped", "checked", "dotted", "speckled", "grained",
    "veined", "gritty", "varied", "upright",
)  # fmt: skip
OUTLINES = ("compact", "rectangular", "long", "tall")
PLACES = ("size", "low", "bottom", "top", "border", "left", "middle")
ROOM = ("level", "sheer", "flush", "height", "waist", "grounded", "rise", "extent")

_MAX_CROP_SIDE = 160  # longest side of the crop on which surfaces are measured, pixels
_MIN_NORMAL_SHARE = 0.3  # share of a region whose normals must be known
_MIN_DEPTH_PIXELS = 16  # pixels of a region that must have a depth
_NEUTRAL_COLOUR_SHARE = 0.25  # share of a region's pixels with a colour at which its evidence is 0
_OUTLINE_MARGIN = 2  # pixels excluded along the outline, which mix with neighbouring regions
_MIN_HOLE_RADIUS = 0.25  # of a ring, relative to the RMS distance from its centre


class Descriptors:
    """Measures regions. ``names`` are the descriptors, in the order of :meth:`measure`.

    Args:
        groups: mapping name -> (colour -> weight). Groups of colours; each group is a descriptor,
            like each colour.
    """

    def __init__(self, colours: ColourNames, groups: Mapping[str, Mapping[str, float]]) -> None:
        self._colours = colours
        self._groups = np.array(
            [[group.get(name, 0.0) for group in groups.values()] for name in colours.names]
        )
        shapes = (*silhouettes.SOLIDS, *OUTLINES)
        self.names = (*colours.names, *groups, *SURFACES, *shapes, *PLACES, *ROOM)

    def measure(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """Measure non-empty masks bool [M, H, W] on uint8 [H, W, 3]: float64 [M, len(names)]."""
        lab, memberships = to_lab(image), self._colours(image)
        crops, rows, room = [], [], []
        for mask in masks:
            x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
            window = np.s_[y : y + h, x : x + w]
            inside = mask[window]
            crops.append(inside)
            shares = memberships[window][inside].mean(0, dtype=np.float64)
            kinds = np.concatenate([shares, np.minimum(shares @ self._groups, 1)])
            surface = _surface(lab[window], inside, shares)
            outline, place = _outline(inside), _place(mask, (x, y, w, h))
            room.append(_room(inside, window, around))
            rows.append(np.concatenate([_share_evidence(kinds), surface, outline, place]))
        table = np.array(rows)
        shape = _solid_evidence(silhouettes.match(crops))
        split = table.shape[1] - len(OUTLINES) - len(PLACES)
        return np.hstack([table[:, :split], shape, table[:, split:], np.array(room)])


def _ramp(value: float, low: float, high: float) -> float:
    """Map ``value`` linearly from [low, high] to [-1, 1], clamped."""
    return min(max((2 * value - low - high) / (high - low), -1.0), 1.0)


def _ramps(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Apply :func:`_ramp` to an array; for a single number it takes ten times as long."""
    return np.clip((2 * values - low - high) / (high - low), -1, 1)


def _share_evidence(shares: np.ndarray) -> np.ndarray:
    """Compute evidence from shares, logarithmically: 1 gives 1, 1/4 gives 0, 1/16 gives -1."""
    return np.clip(1 + np.log(np.maximum(shares, 1e-6)) / np.log(1 / _NEUTRAL_COLOUR_SHARE), -1, 1)


def _solid_evidence(match: np.ndarray) -> np.ndarray:
    """Compute evidence for solids: their outline matches well, and better than all others."""
    best_other = np.stack([np.delete(match, k, axis=1).max(1) for k in range(match.shape[1])], 1)
    return 0.4 * _ramps(match, 0.7, 0.95) + 0.6 * _ramps(match - best_other, -0.04, 0.04)


def _surface(lab: np.ndarray, inside: np.ndarray, shares: np.ndarray) -> list[float]:
    scale = _MAX_CROP_SIDE / max(inside.shape)
    if scale < 1:
        size = tuple(max(1, round(side * scale)) for side in inside.shape[::-1])
        small = cv2.resize(
            inside.view(np.uint8) * np.float32(1), size, interpolation=cv2.INTER_AREA
        )
        if (small > 0.5).any():
            inside, lab = small > 0.5, cv2.resize(lab, size, interpolation=cv2.INTER_AREA)
    p = _measure_pattern(lab, inside)
    lightness = lab[..., 0][inside].astype(np.float64)
    median, bright = np.percentile(lightness, (50, 99))
    kinds = np.exp(-(shares * np.log(np.maximum(shares, 1e-9))).sum())
    two_tone = _ramp(p.two_tone, 0.6, 0.8)
    two_toned = min(_ramp(p.contrast, 18, 40), two_tone)
    parallel, crossed = _ramp(p.along, 0.4, 0.7), _ramp(p.crossed, 0.12, 0.35)
    discs, even = _ramp(p.spot_fill, 0.84, 0.94), _ramp(p.minor, 0.3, 0.44)
    rough, coarse = _ramp(p.roughness, 0.7, 1.6), _ramp(p.roughness, 2.5, 4.5)
    striped = min(two_toned, parallel, _ramp(p.minor, 0.15, 0.35))
    checked = min(two_toned, -parallel, crossed, even)
    dotted = min(
        two_toned, -parallel, -crossed, discs, _ramp(p.spots, 2, 7), -_ramp(p.minor, 0.42, 0.5)
    )
    specks = max(-discs, -_ramp(p.minor / max(p.spots, 1), 0.008, 0.025))
    speckled = min(specks, _ramp(p.spots, 4, 9), _ramp(p.contrast, 12, 28), -crossed, -even)
    # Wooden boards of furniture join at right angles.
    aligned = max(_ramp(p.along, 0.3, 0.55), _ramp(p.crossed, 0.35, 0.6))
    grained = min(aligned, _ramp(p.roughness, 0.7, 1.3), -coarse)
    veined = min(rough, -coarse, -_ramp(p.along, 0.4, 0.6), _ramp(p.contrast, 8, 16))
    bold = max(_ramp(p.two_tone, 0.75, 0.9), _ramp(p.contrast, 30, 45))
    gritty = min(rough, -parallel, -bold)
    lively = min(_ramp(p.roughness, 2.0, 4.5), _ramp(p.contrast, 12, 28))
    varied = min(lively, -two_tone, -speckled)
    return [
        float(_ramp(lightness.mean(), 30, 80)),
        float(_ramp(kinds, 2.0, 4.5)),
        float(min(_ramp(bright - median, 15, 40), _ramp(bright, 70, 95))),
        float(-_ramp(p.roughness, 1.2, 4.0)),
        *(float(e) for e in (striped, checked, dotted, speckled, grained, veined, gritty, varied)),
        float(_ramp(p.upright, -0.2, 0.6)),
    ]


@dataclass(frozen=True)
class Pattern:
    """Features of the texture of a surface; all except ``roughness`` are independent of scale.

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


def _measure_pattern(lab: np.ndarray, mask: np.ndarray) -> Pattern:
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


def _outline(inside: np.ndarray) -> list[float]:
    contours, _ = cv2.findContours(
        np.pad(inside, 1).view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    # Contours run through pixel centres; add the four corners to cover whole pixels.
    hull = cv2.convexHull(np.concatenate(contours))[:, 0]
    hull = cv2.convexHull(np.concatenate([hull + d for d in ((0, 0), (0, 1), (1, 0), (1, 1))]))
    area = float(np.count_nonzero(inside))
    moments = cv2.moments(inside.view(np.uint8), binaryImage=True)
    xx, xy, yy = (moments[name] / area for name in ("mu20", "mu11", "mu02"))
    # A pixel is a unit square, which adds 1/12 to a variance.
    spread = np.linalg.eigvalsh([[xx + 1 / 12, xy], [xy, yy + 1 / 12]])
    h, w = inside.shape
    corners = (
        cv2.approxPolyN(hull.astype(np.float32), 4, ensure_convex=True) if len(hull) > 4 else hull
    )
    return [
        float(_ramp(area / cv2.contourArea(hull), 0.65, 0.9)),
        float(_ramp(area / max(cv2.contourArea(corners), area), 0.7, 0.93)),
        float(_ramp(np.log(spread[1] / spread[0]) / 2, np.log(2), np.log(5))),
        float(_ramp(np.log(h / w), np.log(0.6), np.log(2.2))),
    ]


def _place(mask: np.ndarray, box: tuple[int, int, int, int]) -> list[float]:
    height, width = mask.shape
    x, y, w, h = box
    inside = mask[y : y + h, x : x + w]
    rows, columns = np.count_nonzero(inside, axis=1), np.count_nonzero(inside, axis=0)
    area = int(rows.sum())
    share = area / mask.size
    centre = (rows @ (np.arange(y, y + h) + 0.5)) / area / height
    column = (columns @ (np.arange(x, x + w) + 0.5)) / area / width
    ends = mask[-1], mask[0], mask[:, 0], mask[:, -1]
    edges = [np.count_nonzero(end) / len(end) for end in ends]
    return [
        float(_ramp(np.log(share), np.log(0.003), np.log(0.12))),
        float(_ramp(centre, 0.35, 0.75)),
        float(_ramp(edges[0], 0.0, 0.4)),
        float(_ramp(edges[1], 0.0, 0.4)),
        float(_ramp(sum(edges), 0.0, 0.5)),
        float(-_ramp(column, 0.25, 0.75)),
        float(-_ramp(np.hypot(column - 0.5, centre - 0.5), 0.1, 0.4)),
    ]


def _room(
    inside: np.ndarray, window: tuple[slice, slice], around: Surroundings | None
) -> np.ndarray:
    """Compute the evidence for :data:`ROOM`; 0 where too few pixels have the quantity."""
    out = dict.fromkeys(ROOM, 0.0)
    if around is None:
        return np.array([*out.values()])
    level, height = (
        values[np.isfinite(values)]
        for values in (around.level[window][inside], around.height[window][inside])
    )
    points = around.points[window][inside]
    points = points[np.isfinite(points[:, 0])]
    if len(level) >= _MIN_NORMAL_SHARE * np.count_nonzero(inside):
        out["level"] = _ramp(np.count_nonzero(level > 0.85) / len(level), 0.2, 0.7)
        out["sheer"] = _ramp(np.count_nonzero(np.abs(level) < 0.35) / len(level), 0.3, 0.8)
    if len(points) >= _MIN_DEPTH_PIXELS:
        thin, middle, wide = np.sqrt(np.linalg.eigvalsh(np.cov(points.T)).clip(0))
        out["flush"] = -_ramp(thin / max(middle, 1e-9), 0.08, 0.35)
        # Of an even line, the length is the standard deviation times the root of 12.
        length = max(wide * np.sqrt(12), 1e-9)
        out["extent"] = _ramp(np.log(length), np.log(0.12), np.log(1.5))
    if len(height) >= _MIN_DEPTH_PIXELS:
        low, median, high = np.percentile(height, (5, 50, 95))
        out["height"] = _ramp(median, 0.0, 1.0)
        out["waist"] = -_ramp(abs(median - 0.45), 0.1, 0.4)
        out["grounded"] = -_ramp(low, 0.06, 0.3)
        out["rise"] = _ramp(np.log(max(high - low, 1e-3)), np.log(0.12), np.log(1.0))
    return np.array([*out.values()])
