"""The proposer that needs no weights: regions of a multi-cue merge tree."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage
from skimage.segmentation import watershed

from slgaussian.errors import InputError
from slgaussian.masks import Proposals
from slgaussian.masks.boundaries import boundary_map
from slgaussian.masks.merge import MergeTree, build_tree
from slgaussian.masks.patterns import join_patterns

LEAF_REACH = 7
"""Side in pixels of the window in which a boundary minimum seeds a leaf."""

FINE = 0.12
"""Cut of the tree, far below that for objects, at which repeated patterns are looked for."""


@dataclass(frozen=True)
class Regions:
    """Object-like regions of an image: watershed leaves, merged, cut at one height.

    The masks are disjoint and cover all of ``where``. A region cut in two can be united again at
    query time, one that spans two objects is lost, so the defaults lean to slight
    over-segmentation: 20 to 60 regions in an indoor photograph, one in a blank image.

    Attributes
    ----------
    height : float
        Merging stops here: contrast in units of a full border (0 to about 2), times the fourth
        root of the area share of the smaller region.
    most : int
        Upper bound on the number of regions; the weakest borders go first.
    """

    height: float = 0.28
    most: int = 60

    def propose(
        self, image: np.ndarray, where: np.ndarray | None = None, depth: np.ndarray | None = None
    ) -> Proposals:
        """Propose masks for ``image``; see :class:`slgaussian.masks.MaskProposer`.

        A score is 1 - (height at which the region was complete) / (height at which it would have
        been merged on): 1 for a uniform region in a strong border, near 0 for a doubtful one.

        Raises
        ------
        InputError
            If image, ``where`` or ``depth`` have the wrong type or size, or depth is not finite.
        """
        check_image(image)
        size = image.shape[:2]
        for name, other in (("where", where), ("depth", depth)):
            if other is not None and other.shape != size:
                raise InputError(f"propose {name}: found shape {other.shape}, expected {size}")
        if where is not None and where.dtype != bool:
            raise InputError(f"propose where: found {where.dtype}, expected bool")
        if depth is not None and not np.isfinite(depth).all():
            raise InputError("propose depth: holds NaN or infinity; use 0 where depth is unknown")
        tree = grow_tree(image, where, depth)
        nodes = tree.cut(self.height, self.most)
        labels = tree.labels(nodes)
        merged_at = np.append(tree.height, np.inf)[tree.parent[nodes]]
        scores = 1 - tree.height[nodes] / np.maximum(merged_at, 1e-12)
        masks = labels == np.arange(1, len(nodes) + 1)[:, None, None]
        return Proposals(masks, scores.astype(np.float32))


def grow_tree(
    image: np.ndarray, where: np.ndarray | None = None, depth: np.ndarray | None = None
) -> MergeTree:
    """The merge tree of an image; arguments as in :meth:`Regions.propose`.

    It is grown twice: a low cut of the first tree shows the elements of patterns, and from these,
    with every pattern joined (:func:`join_patterns`), the second one grows. Its leaves are regions.
    """
    boundary = boundary_map(image, depth)
    leaves = watershed_leaves(boundary)
    if where is not None:
        leaves = np.where(where, leaves, -1)
        packed = np.unique(leaves[where], return_inverse=True)[1]
        leaves[where] = packed.astype(np.int32)
    fine = build_tree(image, leaves, boundary, depth)
    elements = fine.labels(fine.cut(FINE, leaves.size)) - 1
    return build_tree(image, join_patterns(image, elements, depth), boundary, depth)


def watershed_leaves(boundary: np.ndarray) -> np.ndarray:
    """Basins of a border strength map [H, W]: connected leaves int32 [H, W], 0 .. N-1."""
    smooth = cv2.GaussianBlur(boundary, (0, 0), 1.0)
    seeds, _ = ndimage.label(smooth == ndimage.minimum_filter(smooth, LEAF_REACH))
    return watershed(smooth, seeds).astype(np.int32) - 1


def check_image(image: np.ndarray) -> None:
    """Raise InputError unless ``image`` is uint8 [H, W, 3] with at least one pixel."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(f"image: found {image.dtype} {image.shape}, expected uint8 [H, W, 3] RGB")
