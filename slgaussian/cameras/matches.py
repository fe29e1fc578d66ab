"""Points that two photographs show both: features found, described and matched.

SIFT (Lowe 2004) by OpenCV with the descriptors of RootSIFT (Arandjelovic and Zisserman 2012).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np

from slgaussian.formats.brief import brief

_ROWS = 128


@dataclass(frozen=True, eq=False)
class Features:
    """What is remarkable in one image.

    Attributes
    ----------
    points : float64 [N, 2]
        Pixels, pixel centres at +0.5.
    descriptors : float32 [N, 128]
        Unit vectors.
    scales : float64 [N]
        Deviation of the Gaussian that each was found with, pixels.
    angles : float64 [N]
        Orientations, radians, clockwise from x.
    """

    points: np.ndarray
    descriptors: np.ndarray
    scales: np.ndarray
    angles: np.ndarray

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.points)


def find_features(grey: np.ndarray, most: int, contrast: float) -> Features:
    """The ``most`` strongest features of a grey uint8 image [H, W]."""
    sift = cv2.SIFT_create(nfeatures=most, contrastThreshold=contrast)
    keys, raw = sift.detectAndCompute(grey, None)
    if raw is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), *np.zeros((2, 0)))
    # Unit vectors, so products rank as distances do.
    descriptors = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-9))
    # OpenCV counts pixel centres at 0.
    points = np.array([key.pt for key in keys]) + 0.5
    scales = np.array([key.size for key in keys]) / 2
    return Features(points, descriptors, scales, np.radians([key.angle for key in keys]))


def match(a: Features, b: Features, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features that are each other's nearest, and nearer than ``ratio`` times the next (Lowe).

    Returns
    -------
    int [M], int [M], float [M]
        Which of each, and the ratio of each match: the smaller the surer.
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0)
    rows = len(a)
    best, top, second = np.empty(rows, int), np.empty(rows, np.float32), np.empty(rows, np.float32)
    column = np.full(len(b), -1, np.float32)
    for start in range(0, rows, _ROWS):  # a few rows at a time stay in the cache
        part = slice(start, start + _ROWS)
        similarity = a.descriptors[part] @ b.descriptors.T
        np.maximum(column, similarity.max(0), out=column)
        own = np.arange(len(similarity))
        best[part] = similarity.argmax(1)
        top[part] = similarity[own, best[part]]
        similarity[own, best[part]] = -1
        second[part] = similarity.max(1)
    nearest, next_nearest = (np.sqrt(np.maximum(2 - 2 * s, 0)) for s in (top, second))
    mutual = np.flatnonzero(top >= column[best])
    # What is there twice, to the bit, is matched once.
    mutual = mutual[np.unique(best[mutual], return_index=True)[1]]
    kept = np.sort(mutual[nearest[mutual] < ratio * next_nearest[mutual]])
    return kept, best[kept], nearest[kept] / next_nearest[kept]


def sift_matches(ref: np.ndarray, src: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mutual SIFT matches (ratio 0.8) of two grey uint8 images.

    Features and matches of the last images are kept.

    Returns
    -------
    float64 [M, 2], float64 [M, 2]
        Pixels in each image, pixel centres at +0.5.
    """
    first, second = _Grey(ref), _Grey(src)
    i, j = _sift_pairs(first, second)
    return _sift(first).points[i], _sift(second).points[j]


def sift(grey: np.ndarray) -> Features:
    """The SIFT features of a grey uint8 image that :func:`sift_pairs` counts."""
    return _sift(_Grey(grey))


def sift_pairs(ref: np.ndarray, src: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As :func:`sift_matches`, but int [M] and int [M], which features of each image."""
    return _sift_pairs(_Grey(ref), _Grey(src))


@dataclass(frozen=True, eq=False)
class _Grey:
    """An image that is equal to another of the same content."""

    pixels: np.ndarray

    @cached_property
    def content(self) -> tuple[tuple[int, ...], bytes]:
        return self.pixels.shape, hashlib.sha256(np.ascontiguousarray(self.pixels).data).digest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Grey) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)


# The cameras are checked by what depth is found from later, and a view meets several others.
@lru_cache(maxsize=32)
def _sift(image: _Grey) -> Features:
    found = find_features(image.pixels, 4000, 0.02)
    for array in (found.points, found.descriptors, found.scales, found.angles):
        array.setflags(write=False)
    return found


@lru_cache(maxsize=256)
def _sift_pairs(first: _Grey, second: _Grey) -> tuple[np.ndarray, np.ndarray]:
    i, j, _ = match(_sift(first), _sift(second), 0.8)
    for array in (i, j):
        array.setflags(write=False)
    return i, j
