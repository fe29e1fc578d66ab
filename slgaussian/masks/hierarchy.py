"""Selection of a few hundred nested or overlapping masks from merge trees over the same leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.masks.merge import MergeTree

NEAR_COPY = 0.95
"""IoU above which the lower ranked of two nodes is dropped."""


def survival(tree: MergeTree) -> np.ndarray:
    """Return the height at which every node merges, relative to the tree, float64 [M] in 0 to 1.

    It is 1 for a root. Nodes with a high value are wholes. (Persistence, the difference between
    this height and the node's own, prefers uniform specks.)
    """
    top = max(float(tree.height.max(initial=0)), 1e-12)
    return np.append(tree.height / top, 1.0)[tree.parent]


def pick_nodes(
    trees: Sequence[MergeTree],
    chosen_sets: np.ndarray,
    min_area: float,
    max_count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the nodes of the trees with the greatest survival.

    Parameters
    ----------
    trees : sequence of MergeTree
        Over the same N leaves.
    chosen_sets : bool [G, N]
        Sets of leaves that are chosen already; near copies of them are dropped.
    min_area : float
        Smallest area in pixels.
    max_count : int
        Largest number of nodes.

    Returns
    -------
    bool [K, N], float32 [K]
        The leaves of the chosen nodes and their :func:`survival`, in falling order of it.
    """
    area = np.bincount(trees[0].leaves[trees[0].leaves >= 0], minlength=chosen_sets.shape[1])
    members, scores = [], []
    for number, tree in enumerate(trees):
        # Leaves are nodes of every tree; take them from the first.
        nodes = np.arange(0 if number == 0 else chosen_sets.shape[1], len(tree.parent))
        stands = survival(tree)[nodes]
        # Near copies are dropped later, so start with more candidates.
        first = np.argsort(-stands, kind="stable")[: 2 * (max_count + len(chosen_sets))]
        members.append(tree.members(nodes[first]))
        scores.append(stands[first])
    member, score = np.concatenate(members), np.concatenate(scores)
    order = np.argsort(-score, kind="stable")
    order = order[member[order] @ area >= min_area]
    everything = np.concatenate([chosen_sets, member[order]])
    copy = _near_copies(everything, area)
    alive = np.ones(len(everything), bool)
    for index in range(len(everything)):
        if alive[index]:
            alive[index + 1 :] &= ~copy[index, index + 1 :]
    chosen = order[np.flatnonzero(alive[len(chosen_sets) :])[:max_count]]
    return member[chosen], score[chosen].astype(np.float32)


def levels_of(member: np.ndarray, middle: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Classify sets of leaves relative to a partition: uint8 [K], 0 part or 2 group.

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
    """Return the pairs of rows of ``member`` bool [K, N] with IoU above NEAR_COPY, bool [K, K].

    Areas are integers, whose float64 sums are exact in any order.
    """
    weighted = member * area.astype(np.float64)
    size = weighted.sum(1)
    shared = weighted @ member.T.astype(np.float64)
    return shared > NEAR_COPY * (size[:, None] + size - shared)
