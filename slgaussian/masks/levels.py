"""Coarser levels above the objects of label maps: the groups that a word may mean as one.

A label map is one partition, and no partition fits every word: of a sofa, cushions may be objects
of their own. The objects of all views grow together in merge trees as the leaves of one view do
(:mod:`slgaussian.masks.merge`), and cuts of these trees are the levels, much as SAM's three
granularities are. An object keeps its id; a level only says what it is part of.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.masks.merge import Cues, build_tree, joint_sums, leaf_sums

CUTS = ((Cues(), 0.4), (Cues(plane=0.25, fill=0.5, size_power=0.1), 0.8))
"""A tree and the height at which it is cut, for each level: things that look and lie alike, and
compact ones. Of about 90 objects in two photographs of an office, 25 and 45 groups are left."""


def group_objects(seen: Sequence[SeenView], label_maps: LabelMaps) -> np.ndarray:
    """Which group every object belongs to at each level of :data:`CUTS`.

    Parameters
    ----------
    seen : sequence of V SeenView
        The photographs that the label maps belong to, in the same order.
    label_maps : LabelMaps
        labels [V, H, W] of N objects.

    Returns
    -------
    int32 [L, N]
        Numbers 0, 1, ... in each level, in the order of ``label_maps.ids``; objects of one number
        are one group. A group is connected, through one view or another.
    """
    ids = label_maps.ids
    if len(ids) == 0:
        return np.zeros((len(CUTS), 0), np.int32)
    sums = []
    for here, labels in zip(seen, label_maps.labels, strict=True):
        leaves = np.where(labels > 0, np.searchsorted(ids, labels), -1).astype(np.int32)
        seen_as = here.view.lab, leaves, here.boundary, here.depth
        sums.append(leaf_sums(*seen_as, count=len(ids), texture=here.texture))
    joint = joint_sums(sums)
    levels = []
    for cues, height in CUTS:
        tree = build_tree(joint, cues)
        levels.append(tree.places(tree.cut(height, len(ids))))
    return np.stack(levels)
