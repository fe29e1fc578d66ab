"""From overlapping proposals to one label map, and the removal of crumbs from it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.measure import label as connected_components

from slgaussian.masks import Proposals

CRUMB_SHARE = 1 / 8000
"""Pieces smaller than this share of the image (30 pixels at 416 x 576) are crumbs."""


def flatten(proposals: Proposals) -> np.ndarray:
    """One label map int32 [H, W] from masks that may overlap; 0 where there is no mask.

    Masks are painted from large to small, so that a small object stays visible on the large one
    that holds it (the area order of SAM pipelines). Of equally large masks the better scored one is
    on top, then the earlier one. Labels are 1, 2, ... in order of painting, without gaps: a mask
    that is covered wholly gets none.
    """
    areas = proposals.masks.sum((1, 2))
    index = np.arange(len(areas))
    labels = np.zeros(proposals.masks.shape[1:], np.int32)
    for rank, mask in enumerate(np.lexsort((-index, proposals.scores, -areas)), start=1):
        labels[proposals.masks[mask]] = rank
    return renumbered(labels[None])[0]


def renumbered(labels: np.ndarray) -> np.ndarray:
    """The same labels, of any shape, numbered from 1 without gaps in ascending order; 0 stays."""
    table = np.zeros(int(labels.max(initial=0)) + 1, np.int32)
    used = np.unique(labels)
    used = used[used > 0]
    table[used] = np.arange(1, len(used) + 1)
    return table[labels]


def without_crumbs(labels: np.ndarray) -> np.ndarray:
    """Give every connected piece smaller than a crumb to the nearest larger piece.

    Unassigned pixels count as a piece too: small holes are filled, and a speck in a wide unassigned
    area becomes unassigned. Where all is crumbs nothing changes.
    """
    pieces = connected_components(labels + 1, connectivity=1, background=0)
    sizes = np.bincount(pieces.ravel())
    crumb = sizes[pieces] < CRUMB_SHARE * labels.size
    if crumb.all() or not crumb.any():
        return labels
    return labels[nearest_pixel(~crumb)]


def nearest_pixel(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column, int32 [H, W] each, of the nearest pixel that is ``known`` bool [H, W]."""
    found = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return tuple(found)
