"""The proposer ``regions``: nodes of multi-cue merge trees, without learned weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.errors import InputError
from slgaussian.masks import Proposals

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

LEVELS = ("s", "m", "l")


@dataclass(frozen=True)
class Regions:
    """Object-like regions of an image: watershed leaves, merged into trees.

    Level ``m``, objects, is the first tree cut at one height: disjoint masks that cover all of
    ``region``, 20 to 90 in a photograph, one in a uniform image. The other levels are nodes of all
    trees with the greatest survival: ``s``, parts, smaller than the object that contains them, and
    ``l``, groups. They overlap. No single partition fits every object: the best of all masks fits
    far better than the best of level ``m``. Only label maps need a partition.

    Attributes
    ----------
    level : "s", "m", "l" or "all"
    height : float
        Height of the cut for objects: contrast in units of a full border (0 to about 2), times the
        fourth root of the area share of the smaller region.
    most_objects : int
        Largest number of objects; the weakest borders are removed first.
    most : int
        Largest number of masks of all levels.

    Raises
    ------
    InputError
        If there is no such level.
    """

    level: str = "m"
    height: float = 0.2
    most_objects: int = 90
    most: int = 400

    def __post_init__(self) -> None:
        if self.level not in (*LEVELS, "all"):
            raise InputError(f"regions level: found {self.level!r}, expected s, m, l or all")

    def propose(self, frame: SeenView, region: np.ndarray | None = None) -> Proposals:
        """Propose masks for a view; see :class:`slgaussian.masks.MaskProposer`.

        A score is the height at which the region merges, relative to the height of its tree.
        Objects come first, then the other levels by falling score.

        Raises
        ------
        InputError
            If ``region`` or the depth have the wrong type or size, or depth is not finite.
        """
        from slgaussian.masks.flatten import CRUMB_SHARE
        from slgaussian.masks.hierarchy import levels_of, pick_nodes, survival
        from slgaussian.masks.segmentation import CUES, grow_trees

        depth, size = frame.depth, frame.image.shape[:2]
        for name, array in (("region", region), ("depth", depth)):
            if array is not None and array.shape != size:
                raise InputError(f"propose {name}: found shape {array.shape}, expected {size}")
        if region is not None and region.dtype != bool:
            raise InputError(f"propose region: found {region.dtype}, expected bool")
        if depth is not None and not np.isfinite(depth).all():
            raise InputError("propose depth: holds NaN or infinity; use 0 where depth is unknown")
        trees = grow_trees(frame, region, CUES[:1] if self.level == "m" else CUES)
        nodes = trees[0].cut(self.height, self.most_objects)
        member = trees[0].members(nodes)
        scores = survival(trees[0])[nodes].astype(np.float32)
        levels = np.ones(len(nodes), np.uint8)
        leaves = trees[0].leaves
        if self.level != "m" and len(nodes):
            spare = max(self.most - len(nodes), 0)
            extra, extra_scores = pick_nodes(trees, member, CRUMB_SHARE * leaves.size, spare)
            area = np.bincount(leaves[leaves >= 0])
            levels = np.append(levels, levels_of(extra, member, area))
            member = np.concatenate([member, extra])
            scores = np.append(scores, extra_scores)
            if self.level != "all":
                wanted = levels == LEVELS.index(self.level)
                member, scores, levels = member[wanted], scores[wanted], levels[wanted]
        outside = np.zeros((len(member), 1), bool)
        masks = np.take(np.append(member, outside, 1), leaves, axis=1)
        return Proposals(masks, scores, levels)
