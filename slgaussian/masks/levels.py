"""Groups of the objects of label maps: what a word may mean as one.

A label map is one partition, and no partition fits every word: of a sofa, cushions may be objects
of their own. The objects of all views grow together in merge trees as the leaves of one view do
(:mod:`slgaussian.masks.merge`). Cuts of these trees are levels, much as SAM's three granularities
are, at which groups are looked at too; every node is a whole that may be an answer. An object
keeps its id; a level only says what it is part of.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.language.wholes import LEAST_SHARE, Wholes
from slgaussian.masks.merge import (
    Cues,
    LeafSums,
    MergeTree,
    build_tree,
    joint_sums,
    leaf_sums,
)
from slgaussian.masks.segmentation import CUES

CUTS = ((Cues(), 0.4), (Cues(plane=0.25, fill=0.5, size_power=0.1), 0.8))
"""A tree and the height at which it is cut, for each level: things that look and lie alike, and
compact ones. Of about 90 objects in two photographs of an office, 25 and 45 groups are left."""


MOST_OBJECTS = 1000
"""Objects that wholes are known of: their nodes are tables of objects by objects."""


class ObjectGroups(NamedTuple):
    """Groups of N objects.

    Attributes
    ----------
    levels : int32 [L, N]
        Group of each object at each level of :data:`CUTS`: numbers 0, 1, ... in each, in the order
        of the ids; objects of one number are one group. A group is connected, through one view or
        another.
    wholes : Wholes or None
        Nodes of several trees, without crumbs; None of more than :data:`MOST_OBJECTS`.
    """

    levels: np.ndarray
    wholes: Wholes | None


def group_objects(seen: Sequence[SeenView], label_maps: LabelMaps) -> ObjectGroups:
    """Find the groups that the objects of label maps may belong to.

    Parameters
    ----------
    seen : sequence of V SeenView
        The photographs that the label maps belong to, in the same order.
    label_maps : LabelMaps
        labels [V, H, W] of N objects, N at least 1.
    """
    ids, sums, at_edge = label_maps.ids, [], np.zeros(len(label_maps.ids), np.float32)
    for here, labels in zip(seen, label_maps.labels, strict=True):
        leaves = np.where(labels > 0, np.searchsorted(ids, labels), -1).astype(np.int32)
        seen_as = here.view.lab, leaves, here.boundary, here.depth
        sums.append(leaf_sums(*seen_as, count=len(ids), texture=here.texture))
        for side in (leaves[0], leaves[-1], leaves[:, 0], leaves[:, -1]):
            at_edge += np.bincount(side[side >= 0], minlength=len(ids)).astype(np.float32)
    joint = joint_sums(sums)
    trees = [build_tree(joint, cues) for cues in CUES]
    cut = [(trees[CUES.index(cues)], height) for cues, height in CUTS]
    levels = [tree.places(tree.cut(height, len(ids))) for tree, height in cut]
    wholes = _wholes(joint, trees, at_edge) if len(ids) <= MOST_OBJECTS else None
    return ObjectGroups(np.stack(levels), wholes)


def _wholes(joint: LeafSums, trees: Sequence[MergeTree], at_edge: np.ndarray) -> Wholes:
    """Return the nodes of all trees that are no crumbs, each set of objects once."""
    count = len(at_edge)
    nodes = np.concatenate([tree.members(np.arange(len(tree.parent))) for tree in trees])
    ends = [np.append(tree.height, tree.height.max())[tree.parent] for tree in trees]
    stands = np.concatenate(ends) - np.concatenate([tree.height for tree in trees])
    packed = np.packbits(nodes, axis=1)
    _, first, place = np.unique(packed, axis=0, return_index=True, return_inverse=True)
    standing = np.bincount(place.ravel(), stands, len(first)) / len(trees)
    # In order of the trees: the first nodes of the first one are the objects.
    order = np.argsort(first)
    first, standing = first[order], standing[order]
    use = (np.arange(len(first)) < count) | (nodes[first] @ joint.size >= LEAST_SHARE)
    return Wholes(
        nodes[first[use]][count:],
        standing[use].astype(np.float32),
        joint.sizes.astype(np.float32),
        at_edge,
        joint.edges.astype(np.int32),
        np.stack([joint.length, joint.strength], 1).astype(np.float32),
    )
