"""The proposer that needs no weights: regions of multi-cue merge trees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage
from skimage.segmentation import watershed

from slgaussian.errors import InputError
from slgaussian.masks import Proposals
from slgaussian.masks.boundaries import boundary_map
from slgaussian.masks.flatten import CRUMB_SHARE
from slgaussian.masks.hierarchy import levels_of, pick_nodes, survival
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

LEVELS = ("s", "m", "l")


@dataclass(frozen=True)
class Regions:
    """Object-like regions of an image: watershed leaves, merged into trees.

    Level ``m``, objects, is the first tree cut at one height: disjoint masks that cover all of
    ``where``, 15 to 60 in an indoor photograph, one in a blank image. The other levels are nodes of
    all trees, chosen by how long they stand: ``s``, parts, smaller than the object in which they
    lie; ``l``, groups. They overlap. One partition cannot fit every object, so that the best of all
    masks fits a thing far better than the best object does; only label maps need a partition.

    Attributes
    ----------
    level : "s", "m", "l" or "all"
    height : float
        Objects stop growing here: contrast in units of a full border (0 to about 2), times the
        fourth root of the area share of the smaller region.
    most_objects : int
        Upper bound on the number of objects; the weakest borders go first.
    most : int
        Upper bound on the number of masks of all levels.

    Raises
    ------
    InputError
        If there is no such level.
    """

    level: str = "m"
    height: float = 0.28
    most_objects: int = 60
    most: int = 400

    def __post_init__(self) -> None:
        if self.level not in (*LEVELS, "all"):
            raise InputError(f"regions level: found {self.level!r}, expected s, m, l or all")

    def propose(
        self, image: np.ndarray, where: np.ndarray | None = None, depth: np.ndarray | None = None
    ) -> Proposals:
        """Propose masks for ``image``; see :class:`slgaussian.masks.MaskProposer`.

        A score is the height at which the region would have been merged on, as a share of that of
        its whole tree. Objects come first, then the other levels in falling order of score.

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
        trees = grow_trees(image, where, depth, CUES[:1] if self.level == "m" else CUES)
        nodes = trees[0].cut(self.height, self.most_objects)
        member = trees[0].members(nodes)
        scores = survival(trees[0])[nodes].astype(np.float32)
        levels = np.ones(len(nodes), np.uint8)
        leaves = trees[0].leaves
        if self.level != "m" and len(nodes):
            spare = max(self.most - len(nodes), 0)
            others, other_scores = pick_nodes(trees, member, CRUMB_SHARE * leaves.size, spare)
            area = np.bincount(leaves[leaves >= 0])
            levels = np.append(levels, levels_of(others, member, area))
            member = np.concatenate([member, others])
            scores = np.append(scores, other_scores)
            if self.level != "all":
                wanted = levels == LEVELS.index(self.level)
                member, scores, levels = member[wanted], scores[wanted], levels[wanted]
        outside = np.zeros((len(member), 1), bool)
        masks = np.take(np.append(member, outside, 1), leaves, axis=1)
        return Proposals(masks, scores, levels)


def grow_trees(
    image: np.ndarray,
    where: np.ndarray | None = None,
    depth: np.ndarray | None = None,
    cues: Sequence[Cues] = CUES,
) -> list[MergeTree]:
    """Merge trees of an image over the same leaves, one for each of the ``cues``; other arguments
    as in :meth:`Regions.propose`.

    A low cut of a first tree shows the elements of patterns; with every pattern joined
    (:func:`join_patterns`) these are the leaves, and so are regions already.
    """
    boundary = boundary_map(image, depth)
    leaves = watershed_leaves(boundary)
    if where is not None:
        leaves = np.where(where, leaves, -1)
        packed = np.unique(leaves[where], return_inverse=True)[1]
        leaves[where] = packed.astype(np.int32)
    fine = build_tree(leaf_sums(image, leaves, boundary, depth))
    elements = fine.labels(fine.cut(FINE, leaves.size)) - 1
    sums = leaf_sums(image, join_patterns(image, elements, depth), boundary, depth)
    return [build_tree(sums, each) for each in cues]


def watershed_leaves(boundary: np.ndarray) -> np.ndarray:
    """Basins of a border strength map [H, W]: connected leaves int32 [H, W], 0 .. N-1."""
    smooth = cv2.GaussianBlur(boundary, (0, 0), 1.0)
    seeds, _ = ndimage.label(smooth == ndimage.minimum_filter(smooth, LEAF_REACH))
    return watershed(smooth, seeds).astype(np.int32) - 1


def check_image(image: np.ndarray) -> None:
    """Raise InputError unless ``image`` is uint8 [H, W, 3] with at least one pixel."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(f"image: found {image.dtype} {image.shape}, expected uint8 [H, W, 3] RGB")
