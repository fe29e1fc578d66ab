"""Detection and matching of local features.

SIFT (Lowe 2004) of OpenCV with RootSIFT descriptors (Arandjelovic and Zisserman 2012).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np

SIFT = 4000, 0.02
"""Largest number of features of an image, and OpenCV's contrast threshold."""

LOWE_RATIO = 0.8
"""Largest ratio of nearest to second-nearest descriptor distance (:func:`match`)."""

_ROWS = 128


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of one image.

    Attributes:
        points: float64 [N, 2]. Pixels, pixel centres at +0.5.
        descriptors: float32 [N, 128]. Unit vectors.
        scales: float64 [N]. Standard deviation of the Gaussian at which each was detected, pixels.
        angles: float64 [N]. Orientations, radians, clockwise from x.
    """

    points: np.ndarray
    descriptors: np.ndarray
    scales: np.ndarray
    angles: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, rows: np.ndarray) -> Features:
        return Features(*(getattr(self, item.name)[rows] for item in fields(self)))


def find_features(grey: np.ndarray, limit: int, contrast: float) -> Features:
    """Return the ``limit`` strongest features of a grey uint8 image [H, W]."""
    detector = cv2.SIFT_create(nfeatures=limit, contrastThreshold=contrast)
    keys, raw = detector.detectAndCompute(grey, None)
    rows = [(*key.pt, key.size, key.angle) for key in keys]
    x, y, size, angle = np.array(rows, np.float64).reshape(-1, 4).T
    raw = np.zeros((0, 128), np.float32) if raw is None else raw
    # The descriptors are unit vectors, so dot products rank like distances.
    descriptors = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-9))
    # OpenCV counts pixel centres at 0.
    return Features(np.stack([x, y], 1) + 0.5, descriptors, size / 2, np.radians(angle))


def match(a: Features, b: Features, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Match mutual nearest neighbours that pass Lowe's ratio test with ``ratio``.

    Returns:
        int [M], int [M], float [M]: Feature indices in ``a`` and ``b``, and the ratio of each
            match; smaller is more reliable.
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0)
    rows = len(a)
    best, top, second = np.empty(rows, int), np.empty(rows, np.float32), np.empty(rows, np.float32)
    column = np.full(len(b), -1, np.float32)
    for start in range(0, rows, _ROWS):  # blocks of rows fit into the CPU cache
        part = slice(start, start + _ROWS)
        similarity = a.descriptors[part] @ b.descriptors.T
        np.maximum(column, similarity.max(0), out=column)
        indices = np.arange(len(similarity))
        best[part] = similarity.argmax(1)
        top[part] = similarity[indices, best[part]]
        similarity[indices, best[part]] = -1
        second[part] = similarity.max(1)
    nearest, next_nearest = (np.sqrt(np.maximum(2 - 2 * s, 0)) for s in (top, second))
    mutual = np.flatnonzero(top >= column[best])
    # Of features with identical descriptors only the first is matched.
    mutual = mutual[np.unique(best[mutual], return_index=True)[1]]
    matched = np.sort(mutual[nearest[mutual] < ratio * next_nearest[mutual]])
    return matched, best[matched], nearest[matched] / next_nearest[matched]


def sift(grey: np.ndarray) -> Features:
    """Return the SIFT features of a grey uint8 image with the parameters :data:`SIFT`."""
    return find_features(grey, *SIFT)
