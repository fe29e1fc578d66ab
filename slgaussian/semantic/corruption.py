"""Corruption of label maps: simulated failures of segmentation and tracking.

Used for training, with clean targets, and for evaluation. Each kind corrupts one object in one
view, so that views of the object disagree.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

EROSION = 0.02
"""Width of the eroded rim, as a fraction of the shorter image side."""

MIN_AREA = 0.001
"""Objects that cover a smaller fraction of a view are not corrupted there."""


def missing(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """Delete the object from the view, as if segmentation had missed it."""
    labels[view][labels[view] == ident] = 0


def wrong_id(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """Give the object a new id in the view, as if tracking had lost it."""
    labels[view][labels[view] == ident] = labels.max() + 1


def eroded(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """Erode the object's mask in the view."""
    mask = (labels[view] == ident).astype(np.uint8)
    radius = max(1, round(EROSION * min(mask.shape)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    # The object is assumed to continue beyond the image, so nothing is eroded at the image border.
    remains = cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    labels[view][(mask > 0) & (remains == 0)] = 0


def merged(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """Give the object the id of a random neighbour in the view, as if they were one object."""
    mask = labels[view] == ident
    near = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    neighbours = np.unique(labels[view][near & ~mask])
    neighbours = neighbours[neighbours > 0]
    if len(neighbours):
        labels[view][mask] = rng.choice(neighbours)


KINDS: dict[str, Callable[[np.ndarray, int, int, np.random.Generator], None]] = {
    "missing": missing,
    "wrong id": wrong_id,
    "eroded": eroded,
    "merged": merged,
}


def corrupt(
    labels: np.ndarray,
    rng: np.random.Generator,
    fraction: float = 0.3,
    kinds: tuple[str, ...] = tuple(KINDS),
) -> np.ndarray:
    """Copy label maps and corrupt some of their objects, each in one view.

    Parameters
    ----------
    labels : int32 [V, H, W]
        Object ids; 0 is unassigned.
    rng : numpy Generator
        Draws the objects, their views and the kinds.
    fraction : float
        Probability that an object is corrupted.
    kinds : tuple of str
        Keys of :data:`KINDS`, equally likely.
    """
    labels = labels.copy()
    ids = np.unique(labels)
    smallest = MIN_AREA * labels[0].size
    views_of = {
        ident: [v for v, view in enumerate(labels) if np.count_nonzero(view == ident) >= smallest]
        for ident in ids[ids > 0].tolist()
    }
    for ident, views in views_of.items():
        # Always three draws an object, so that objects are independent of each other.
        hit, which, kind = rng.random(), rng.random(), rng.integers(len(kinds))
        if hit < fraction and views:
            KINDS[kinds[kind]](labels, views[int(which * len(views))], ident, rng)
    return labels
