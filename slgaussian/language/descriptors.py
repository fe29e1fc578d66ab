"""Measurements of image regions: evidence for or against each descriptor.

Evidence lies in [-1, 1]: 1 for, -1 against, 0 undecided. Lengths are relative to the image or the
region, so that the resolution of a photograph has little influence.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from slgaussian.geometry.room import Surroundings
from slgaussian.language import patterns, silhouettes
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
    p = patterns.measure(lab, inside)
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
