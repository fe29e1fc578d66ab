"""Points that two photographs show both: features found, described and matched.

SIFT (Lowe 2004) by OpenCV with the descriptors of RootSIFT (Arandjelovic and Zisserman 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np

from slgaussian.formats.brief import brief
from slgaussian.kernels.seeding import content_of
from slgaussian.storage.derived import Arrays, once

SIFT = 4000, 0.02
RATIO = 0.8
"""Features of an image that views are matched by, at most, and the contrast that they need; and how
much nearer than the next the nearest must be (:func:`match`)."""

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
    """The ``most`` strongest features of a grey uint8 image [H, W].

    Those of the last images are at hand; kept as :mod:`slgaussian.storage.derived` says.
    """
    image = _Grey(grey)
    found = once(
        "features",
        1,
        lambda: f"{image.content} {most} {contrast}",
        lambda: _detected(image, most, contrast),
    )
    raw = found["descriptors"].astype(np.float32)
    # Unit vectors, so products rank as distances do.
    descriptors = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-9))
    x, y, size, angle = found["keys"].astype(np.float64).T
    # OpenCV counts pixel centres at 0.
    return Features(np.stack([x, y], 1) + 0.5, descriptors, size / 2, np.radians(angle))


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

    Returns
    -------
    float64 [M, 2], float64 [M, 2]
        Pixels in each image, pixel centres at +0.5.
    """
    i, j = sift_pairs(ref, src)
    return sift(ref).points[i], sift(src).points[j]


def sift(grey: np.ndarray) -> Features:
    """The SIFT features of a grey uint8 image that :func:`sift_pairs` counts."""
    return find_features(grey, *SIFT)


def sift_pairs(ref: np.ndarray, src: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As :func:`sift_matches`, but int [M] and int [M], which features of each image.

    Those of the last images are at hand; kept as :mod:`slgaussian.storage.derived` says.
    """
    first, second = _Grey(ref), _Grey(src)
    found = once(
        "matches",
        1,
        lambda: f"{first.content} {second.content} {SIFT} {RATIO}",
        lambda: _matched(first, second),
    )
    return found["i"], found["j"]


@dataclass(frozen=True, eq=False)
class _Grey:
    """An image that is equal to another of the same content."""

    pixels: np.ndarray

    @cached_property
    def content(self) -> str:
        return content_of(self.pixels)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Grey) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)


# The cameras are checked by what depth is found from later, and a view meets several others.
@lru_cache(maxsize=32)
def _detected(image: _Grey, most: int, contrast: float) -> Arrays:
    """Position, size and angle of features as OpenCV says them, and descriptors, uint8."""
    sift = cv2.SIFT_create(nfeatures=most, contrastThreshold=contrast)
    keys, raw = sift.detectAndCompute(image.pixels, None)
    told = np.array([(*key.pt, key.size, key.angle) for key in keys], np.float32).reshape(-1, 4)
    descriptors = np.zeros((0, 128), np.uint8) if raw is None else raw.astype(np.uint8)
    return _unchanging(keys=told, descriptors=descriptors)


@lru_cache(maxsize=256)
def _matched(first: _Grey, second: _Grey) -> Arrays:
    i, j, _ = match(sift(first.pixels), sift(second.pixels), RATIO)
    return _unchanging(i=i, j=j)


def _unchanging(**arrays: np.ndarray) -> Arrays:
    for array in arrays.values():
        array.setflags(write=False)
    return arrays
