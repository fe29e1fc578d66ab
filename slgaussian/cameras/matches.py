"""Points that two photographs show both: features found, described and matched."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np


def sift_matches(ref: np.ndarray, src: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mutual SIFT matches (Lowe 2004, ratio 0.8) of two grey uint8 images.

    Returns
    -------
    float64 [M, 2], float64 [M, 2]
        Pixels in each image, pixel centres at +0.5; read-only, as who asks again for the same two
        images gets the same arrays.
    """
    return _sift_matches(_Grey(ref), _Grey(src))


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


@lru_cache(maxsize=4)  # the cameras are checked by what depth is found from later
def _sift_matches(first: _Grey, second: _Grey) -> tuple[np.ndarray, np.ndarray]:
    ref, src = first.pixels, second.pixels
    sift = cv2.SIFT_create(nfeatures=4000, contrastThreshold=0.02)
    found = [sift.detectAndCompute(image, None) for image in (ref, src)]
    none = np.zeros((0, 2)), np.zeros((0, 2))
    if any(descriptors is None or len(descriptors) < 2 for _, descriptors in found):
        return none
    (points_a, a), (points_b, b) = found
    # RootSIFT (Arandjelovic and Zisserman 2012): unit vectors, so products rank as distances do.
    a, b = (np.sqrt(d / np.maximum(d.sum(1, keepdims=True), 1e-9)) for d in (a, b))
    similarity = a @ b.T
    best, back = similarity.argmax(1), similarity.argmax(0)
    top = np.partition(similarity, -2, axis=1)[:, -2:]
    nearest, next_nearest = (np.sqrt(np.maximum(2 - 2 * top[:, k], 0)) for k in (1, 0))
    keep = (back[best] == np.arange(len(a))) & (nearest < 0.8 * next_nearest)
    if not keep.any():
        return none
    # OpenCV counts pixel centres at 0.
    xy_a = np.array([p.pt for p in points_a])[keep] + 0.5
    xy_b = np.array([p.pt for p in points_b])[best[keep]] + 0.5
    for xy in (xy_a, xy_b):
        xy.setflags(write=False)
    return xy_a, xy_b
