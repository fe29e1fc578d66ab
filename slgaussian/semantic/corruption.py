"""Label maps as bad as masks get: the ways in which segmentation and tracking fail.

To learn from, while the targets stay clean, and to judge by. Each kind harms one object in one
view: what several views say about an object then differs.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

ERODED = 0.02
"""How much is eroded, as a fraction of the shorter image side."""

LEAST = 0.001
"""Objects that fill less of a view than this are left alone there."""


def missing(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """The object was not found in the view."""
    labels[view][labels[view] == ident] = 0


def wrong_id(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """The object was not recognised in the view: it has an id of its own there."""
    labels[view][labels[view] == ident] = labels.max() + 1


def eroded(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """The mask of the object in the view lacks a rim."""
    mask = (labels[view] == ident).astype(np.uint8)
    reach = max(1, round(ERODED * min(mask.shape)))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    # What lies beyond the image is more of the object, so there is no rim at the border.
    remains = cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    labels[view][(mask > 0) & (remains == 0)] = 0


def merged(labels: np.ndarray, view: int, ident: int, rng: np.random.Generator) -> None:
    """The object was taken for a part of a neighbour in the view, with which it shares a border."""
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
    """A copy of label maps in which some objects are harmed, each in one view.

    Parameters
    ----------
    labels : int32 [V, H, W]
        Object ids; 0 is unassigned.
    rng : numpy Generator
        Decides which objects, in which view, and how.
    fraction : float
        Probability of each object to be harmed.
    kinds : tuple of str
        Keys of :data:`KINDS`, equally likely.
    """
    labels = labels.copy()
    ids = np.unique(labels)
    smallest = LEAST * labels[0].size
    views_of = {
        ident: [v for v, view in enumerate(labels) if np.count_nonzero(view == ident) >= smallest]
        for ident in ids[ids > 0].tolist()
    }
    for ident, views in views_of.items():
        # The same numbers are drawn whatever comes of them, so that objects do not share a fate.
        hit, which, kind = rng.random(), rng.random(), rng.integers(len(kinds))
        if hit < fraction and views:
            KINDS[kinds[kind]](labels, views[int(which * len(views))], ident, rng)
    return labels
