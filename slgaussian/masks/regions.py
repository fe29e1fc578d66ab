"""The proposer ``regions``: nodes of a multi-cue merge tree, without learned weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.masks import Proposals

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

CUT_HEIGHT = 0.2
"""Height of the cut: contrast in units of a full border (0 to about 2), times the fourth root of
the area share of the smaller region."""

MAX_REGIONS = 90
"""Largest number of regions; the weakest borders are removed first."""


@dataclass(frozen=True)
class Regions:
    """Object-like regions of an image: watershed leaves, merged into a tree, cut at one height.

    The masks are disjoint and cover all of ``region``: 20 to 90 in a photograph, one in a uniform
    image.
    """

    def propose(self, frame: SeenView, region: np.ndarray | None = None) -> Proposals:
        """Propose masks for a view; see :class:`slgaussian.masks.MaskProposer`.

        A score is the height at which the region merges, relative to the height of the tree.
        """
        from slgaussian.masks.segmentation import grow_tree

        tree = grow_tree(frame, region)
        nodes = tree.cut(CUT_HEIGHT, MAX_REGIONS)
        masks = tree.labels(nodes) == np.arange(1, len(nodes) + 1)[:, None, None]
        top = max(float(tree.height.max(initial=0)), 1e-12)
        merged_at = np.append(tree.height / top, 1.0)[tree.parent]  # a root never merges: 1
        return Proposals(masks, merged_at[nodes].astype(np.float32))
