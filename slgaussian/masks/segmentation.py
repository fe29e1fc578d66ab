"""The merge tree of an image over watershed leaves, the basis of the proposer ``regions``."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage
from skimage.segmentation import watershed

from slgaussian.geometry import SeenView
from slgaussian.masks.merge import Cues, MergeTree, build_tree, leaf_sums
from slgaussian.masks.patterns import join_patterns

LEAF_WINDOW = 7
"""Side in pixels of the window in which a minimum of the border strength seeds a leaf."""

PATTERN_CUT_HEIGHT = 0.12
"""Height of the cut, far below that of objects, at which repeated patterns are detected."""

CUES = (
    Cues(),
    Cues(colour=0.0, texture=0.4, plane=0.25, fill=0.2, size_power=0.6),
    Cues(plane=0.25, fill=0.5, size_power=0.1),
)
"""Cues of three complementary trees: objects; even growth without colour, for objects of many
colours; compact regions, of which small ones survive long."""


def grow_tree(frame: SeenView, region: np.ndarray | None = None) -> MergeTree:
    """Build the merge tree of a view.

    Arguments are as in :meth:`slgaussian.masks.regions.Regions.propose`. The leaves are the regions
    of a low cut of a first tree, with repeated patterns merged (:func:`join_patterns`).
    """
    lab, depth, boundary = frame.view.lab, frame.depth, frame.boundary
    leaves = watershed_leaves(boundary)
    if region is not None:
        leaves = np.where(region, leaves, -1)
        packed = np.unique(leaves[region], return_inverse=True)[1]
        leaves[region] = packed.astype(np.int32)
    fine = build_tree(leaf_sums(lab, leaves, boundary, depth, texture=frame.texture))
    elements = fine.labels(fine.cut(PATTERN_CUT_HEIGHT, leaves.size)) - 1
    joined = join_patterns(lab, elements, depth)
    return build_tree(leaf_sums(lab, joined, boundary, depth, texture=frame.texture))


def watershed_leaves(boundary: np.ndarray) -> np.ndarray:
    """Compute watershed basins of a border strength map [H, W]: leaves int32 [H, W], 0 .. N-1."""
    smooth = cv2.GaussianBlur(boundary, (0, 0), 1.0)
    seeds, _ = ndimage.label(smooth == ndimage.minimum_filter(smooth, LEAF_WINDOW))
    return watershed(smooth, seeds).astype(np.int32) - 1
