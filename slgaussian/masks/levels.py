"""Groups of the objects of label maps, as further candidates for the answer to a text.

No partition fits every text: the cushions of a sofa may be separate objects. Objects of all views
are merged into trees (:mod:`slgaussian.masks.merge`). Cuts of these trees are levels, comparable to
the three granularities of SAM, and every node is a candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.language.wholes import MIN_SHARE, Wholes
from slgaussian.masks.merge import Cues, LeafSums, MergeTree, build_tree, joint_sums, leaf_sums
from slgaussian.masks.segmentation import CUES

CUTS = ((Cues(), 0.4), (Cues(plane=0.25, fill=0.5, size_power=0.1), 0.8))
"""Tree and height of the cut of each level: regions of similar appearance and position, and compact
ones. About 90 objects in two photographs of an office make 25 and 45 groups."""

MAX_OBJECTS = 1000
"""Largest number of objects for which wholes are computed, as their table is quadratic in it."""


class ObjectGroups(NamedTuple):
    """Groups of N objects.

    Attributes:
        levels: int32 [L, N]. Group of each object at each level of :data:`CUTS`, numbered 0, 1, ...
            in each level, in the order of the ids. A group is connected in some view.
        wholes: Nodes of several trees, without crumbs; None with more than :data:`MAX_OBJECTS`
            objects.
    """

    levels: np.ndarray
    wholes: Wholes | None


def group_objects(frames: Sequence[SeenView], label_maps: LabelMaps) -> ObjectGroups:
    """Find the groups of the objects of label maps.

    Args:
        frames: sequence of V SeenView. The photographs of the label maps, in the same order.
        label_maps: labels [V, H, W] of N objects, N at least 1.
    """
    ids, sums, at_edge = label_maps.ids, [], np.zeros(len(label_maps.ids), np.float32)
    for frame, labels in zip(frames, label_maps.labels, strict=True):
        leaves = np.where(labels > 0, np.searchsorted(ids, labels), -1).astype(np.int32)
        pixels = frame.view.lab, leaves, frame.boundary, frame.depth
        sums.append(leaf_sums(*pixels, count=len(ids), texture=frame.texture))
        for side in (leaves[0], leaves[-1], leaves[:, 0], leaves[:, -1]):
            at_edge += np.bincount(side[side >= 0], minlength=len(ids)).astype(np.float32)
    joint = joint_sums(sums)
    trees = [build_tree(joint, cues) for cues in CUES]
    cut = [(trees[CUES.index(cues)], height) for cues, height in CUTS]
    levels = [tree.places(tree.cut(height, len(ids))) for tree, height in cut]
    wholes = _wholes(joint, trees, at_edge) if len(ids) <= MAX_OBJECTS else None
    return ObjectGroups(np.stack(levels), wholes)


def _wholes(joint: LeafSums, trees: Sequence[MergeTree], at_edge: np.ndarray) -> Wholes:
    """Return the distinct sets of objects of all trees that are larger than crumbs."""
    count = len(at_edge)
    nodes = np.concatenate([tree.members() for tree in trees])
    ends = [np.append(tree.height, tree.height.max())[tree.parent] for tree in trees]
    stands = np.concatenate(ends) - np.concatenate([tree.height for tree in trees])
    packed = np.packbits(nodes, axis=1)
    _, first, place = np.unique(packed, axis=0, return_index=True, return_inverse=True)
    standing = np.bincount(place.ravel(), stands, len(first)) / len(trees)
    # In order of the trees: the first nodes of the first one are the objects.
    order = np.argsort(first)
    first, standing = first[order], standing[order]
    use = (np.arange(len(first)) < count) | (nodes[first] @ joint.means[:, 0] >= MIN_SHARE)
    return Wholes(
        nodes[first[use]][count:],
        standing[use].astype(np.float32),
        joint.views[..., 0].astype(np.float32),
        at_edge,
        joint.edges.astype(np.int32),
        joint.borders.astype(np.float32),
    )
