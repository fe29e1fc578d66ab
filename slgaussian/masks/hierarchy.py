"""From several merge trees over the same leaves to a few hundred nested or overlapping masks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.masks.merge import MergeTree

NEAR_COPY = 0.95
"""The later one of two nodes with a larger IoU is left out."""


def survival(tree: MergeTree) -> np.ndarray:
    """How long every node stands, float64 [M] in 0 to 1: the height at which it is merged on, as a
    share of the height of the tree; 1 for a root.

    What stands long is a whole, whether or not it took long to grow. (Persistence, the share of
    that height which passed since the node was made, prefers uniform specks.)
    """
    top = max(float(tree.height.max(initial=0)), 1e-12)
    return np.append(tree.height / top, 1.0)[tree.parent]


def pick_nodes(
    trees: Sequence[MergeTree],
    given: np.ndarray,
    least: float,
    most: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Choose nodes of the trees, those that stand longest first.

    Parameters
    ----------
    trees : sequence of MergeTree
        Over the same N leaves.
    given : bool [G, N]
        Sets of leaves that are chosen already; what nearly equals one of them is left out.
    least : float
        Smallest area in pixels.
    most : int
        Number of nodes to choose at most.

    Returns
    -------
    bool [K, N], float32 [K]
        The leaves of the chosen nodes and their :func:`survival`, in falling order of it.
    """
    area = np.bincount(trees[0].leaves[trees[0].leaves >= 0], minlength=given.shape[1])
    members, scores = [], []
    for number, tree in enumerate(trees):
        # Leaves are in every tree; where the first keeps them longest decides nothing.
        nodes = np.arange(0 if number == 0 else given.shape[1], len(tree.parent))
        stands = survival(tree)[nodes]
        # Near copies fall away later, so somewhat more are looked at than can be chosen.
        first = np.argsort(-stands, kind="stable")[: 2 * (most + len(given))]
        members.append(tree.members(nodes[first]))
        scores.append(stands[first])
    member, score = np.concatenate(members), np.concatenate(scores)
    order = np.argsort(-score, kind="stable")
    order = order[member[order] @ area >= least]
    everything = np.concatenate([given, member[order]])
    copy = _near_copies(everything, area)
    alive = np.ones(len(everything), bool)
    for index in range(len(everything)):
        if alive[index]:
            alive[index + 1 :] &= ~copy[index, index + 1 :]
    chosen = order[np.flatnonzero(alive[len(given) :])[:most]]
    return member[chosen], score[chosen].astype(np.float32)


def levels_of(member: np.ndarray, middle: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Level of sets of leaves next to a partition: uint8 [K], 0 part or 2 group.

    Parameters
    ----------
    member : bool [K, N]
    middle : bool [G, N]
        The partition: level 1.
    area : float or int [N]
        Of the leaves.
    """
    shared = (member * area).astype(np.float64) @ middle.T.astype(np.float64)
    home = shared.argmax(1)
    return np.where(member @ area < (middle @ area)[home], 0, 2).astype(np.uint8)


def _near_copies(member, area):
    """Which rows of ``member`` bool [K, N] have IoU above NEAR_COPY: bool [K, K].

    Areas are whole numbers, which float64 sums exactly, in any order.
    """
    weighted = member * area.astype(np.float64)
    size = weighted.sum(1)
    shared = weighted @ member.T.astype(np.float64)
    return shared > NEAR_COPY * (size[:, None] + size - shared)
