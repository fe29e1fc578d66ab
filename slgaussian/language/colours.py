"""Colour naming: soft membership of sRGB values in named colours, without training.

Every name has swatches (``vocabulary.toml``); memberships depend on the CIELAB distance to each
name's nearest swatch. A swatch stands for a line of colours: the same surface under less light,
which scales linear RGB, down to the intensity at which people change the name (a dark red wall is
red, but very dark orange is called brown). These lines meet near black, so the chroma required of a
red decreases with lightness.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import cv2
import numpy as np

from slgaussian.formats.colour import decode_srgb, encode_srgb

SHADE_STEP = 0.5
"""Ratio of intensities of neighbouring points on a swatch's line; at most about 20 in L*."""

LIGHTNESS_WEIGHT = 0.7
"""Weight of L* relative to a* and b*: illumination changes lightness more than hue."""

TRANSITION_WIDTH = 5.0
"""Width of the transition between names, CIELAB units (about two just-noticeable differences)."""

_BITS = 6
"""Bits per sRGB channel of the lookup; its cells are smaller than TRANSITION_WIDTH, even near
black."""


def to_lab(rgb: np.ndarray) -> np.ndarray:
    """Convert sRGB, uint8 or float in [0, 1], to CIELAB (D65) float32 [H, W, 3], L* in [0, 100]."""
    scale = 255 if rgb.dtype == np.uint8 else 1
    return cv2.cvtColor(rgb.astype(np.float32) / np.float32(scale), cv2.COLOR_RGB2Lab)


class ColourNames:
    """Computes the membership of sRGB values in each of ``names``, which are in input order.

    Args:
        swatches: mapping name -> (list of "#rrggbb", darkest). ``darkest`` is the smallest factor
            of linear RGB with which a swatch keeps its name; 1 if only the swatch itself has it.
    """

    def __init__(self, swatches: Mapping[str, tuple[list[str], float]]) -> None:
        self.names = tuple(swatches)
        self._swatches = tuple(swatches.values())

    @cached_property
    def _points(self) -> list[np.ndarray]:
        """Swatch points of each name, computed on first use: encoding texts needs none."""
        return [_points(*swatch) for swatch in self._swatches]

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """Compute memberships [..., number of names], summing to 1, of sRGB uint8 [..., 3]."""
        r, g, b = np.moveaxis(rgb >> (8 - _BITS), -1, 0).astype(np.int32)
        cells = (r << 2 * _BITS) | (g << _BITS) | b
        # Compute memberships of the cells that occur, which are few, then look up every pixel.
        used = np.flatnonzero(np.bincount(cells.ravel(), minlength=1 << 3 * _BITS))
        levels = np.stack([used >> 2 * _BITS, used >> _BITS, used], -1) & ((1 << _BITS) - 1)
        lab = _weighted_lab(((levels + 0.5) / (1 << _BITS))[None])
        nearest = np.stack([_distance2(lab, points) for points in self._points], -1)
        closeness = np.exp((nearest.min(-1, keepdims=True) - nearest) / (2 * TRANSITION_WIDTH**2))
        row = np.zeros(1 << 3 * _BITS, np.int32)
        row[used] = np.arange(len(used))
        return (closeness / closeness.sum(-1, keepdims=True))[row[cells]]


def _points(hexes: list[str], darkest: float) -> np.ndarray:
    """Compute the weighted CIELAB points [S, 3] of one colour name."""
    rgb = np.array([[int(h[i : i + 2], 16) for i in (1, 3, 5)] for h in hexes]) / 255
    linear = decode_srgb(rgb)
    steps = 1 + int(np.ceil(np.log(darkest) / np.log(SHADE_STEP)))
    linear = (linear * np.geomspace(1, darkest, steps)[:, None, None]).reshape(-1, 3)
    return _weighted_lab(encode_srgb(linear)[None])


def _weighted_lab(rgb: np.ndarray) -> np.ndarray:
    return to_lab(rgb)[0] * np.array([LIGHTNESS_WEIGHT, 1, 1], np.float32)


def _distance2(points: np.ndarray, swatches: np.ndarray) -> np.ndarray:
    """Compute the squared distance from each point [P, 3] to the nearest swatch, [P]."""
    planes = np.ascontiguousarray(points.T)
    nearest = np.full(len(points), np.inf, points.dtype)
    for swatch in swatches:
        light, red, yellow = ((plane - x) ** 2 for plane, x in zip(planes, swatch, strict=True))
        np.minimum(nearest, light + red + yellow, out=nearest)
    return nearest
