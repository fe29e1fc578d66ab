"""Conversion of overlapping proposals to one label map, and removal of small pieces."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.measure import label as connected_components
from skimage.segmentation import relabel_sequential

from slgaussian.masks import Proposals

CRUMB_SHARE = 1 / 8000
"""Share of the image (30 pixels at 416 x 576) below which a connected piece is a crumb."""


def flatten(proposals: Proposals) -> np.ndarray:
    """Convert masks that may overlap to a label map int32 [H, W]; 0 where there is no mask.

    Masks are painted from large to small, so that a small object stays visible on a large one
    (the area order of SAM pipelines). Of equally large masks the one with the higher score is on
    top, then the earlier one. Labels are 1, 2, ... in order of painting; completely covered masks
    have none.
    """
    areas = proposals.masks.sum((1, 2))
    index = np.arange(len(areas))
    labels = np.zeros(proposals.masks.shape[1:], np.int32)
    for rank, mask in enumerate(np.lexsort((-index, proposals.scores, -areas)), start=1):
        labels[proposals.masks[mask]] = rank
    return renumber(labels[None])[0]


def renumber(labels: np.ndarray) -> np.ndarray:
    """Renumber labels of any shape from 1 without gaps in ascending order; 0 does not change."""
    return relabel_sequential(labels)[0].astype(np.int32)


def remove_crumbs(labels: np.ndarray) -> np.ndarray:
    """Assign the pixels of every crumb the label of the nearest larger piece.

    Unassigned pixels form pieces too: small holes are filled, and a speck in a large unassigned
    area becomes unassigned. A map of crumbs alone does not change.
    """
    pieces = connected_components(labels + 1, connectivity=1, background=0)
    sizes = np.bincount(pieces.ravel())
    crumb = sizes[pieces] < CRUMB_SHARE * labels.size
    if crumb.all() or not crumb.any():
        return labels
    return labels[nearest_pixel(~crumb)]


def nearest_pixel(valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of the nearest ``valid`` pixel, int32 [H, W] each."""
    indices = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return tuple(indices)
