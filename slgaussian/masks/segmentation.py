"""Merge trees of an image over watershed leaves: what regions are made of."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy import ndimage
from skimage.segmentation import watershed

from slgaussian.geometry import SeenView
from slgaussian.masks.merge import Cues, MergeTree, build_tree, leaf_sums
from slgaussian.masks.patterns import join_patterns

LEAF_REACH = 7
"""Side in pixels of the window in which a boundary minimum seeds a leaf."""

FINE = 0.12
"""Cut of the tree, far below that for objects, at which repeated patterns are looked for."""

CUES = (
    Cues(),
    Cues(color=0.0, texture=0.4, plane=0.25, fill=0.2, size_power=0.6),
    Cues(plane=0.25, fill=0.5, size_power=0.1),
)
"""One tree each, as different as they are good: objects; even growth that is blind to colour, so
that a thing of many colours is one; compact pieces, with small ones standing long."""


def grow_trees(
    seen: SeenView, where: np.ndarray | None = None, cues: Sequence[Cues] = CUES
) -> list[MergeTree]:
    """Merge trees of a view over the same leaves, one for each of the ``cues``; other arguments
    as in :meth:`slgaussian.masks.regions.Regions.propose`.

    A low cut of a first tree shows the elements of patterns; with every pattern joined
    (:func:`join_patterns`) these are the leaves, and so are regions already.
    """
    lab, depth, boundary = seen.view.lab, seen.depth, seen.boundary
    leaves = watershed_leaves(boundary)
    if where is not None:
        leaves = np.where(where, leaves, -1)
        packed = np.unique(leaves[where], return_inverse=True)[1]
        leaves[where] = packed.astype(np.int32)
    fine = build_tree(leaf_sums(lab, leaves, boundary, depth, texture=seen.texture))
    elements = fine.labels(fine.cut(FINE, leaves.size)) - 1
    joined = join_patterns(lab, elements, depth)
    sums = leaf_sums(lab, joined, boundary, depth, texture=seen.texture)
    return [build_tree(sums, each) for each in cues]


def watershed_leaves(boundary: np.ndarray) -> np.ndarray:
    """Basins of a border strength map [H, W]: connected leaves int32 [H, W], 0 .. N-1."""
    smooth = cv2.GaussianBlur(boundary, (0, 0), 1.0)
    seeds, _ = ndimage.label(smooth == ndimage.minimum_filter(smooth, LEAF_REACH))
    return watershed(smooth, seeds).astype(np.int32) - 1
