"""Checks, stripes and tiles: the elements of one repeated pattern become one region.

A local border says nothing about patterns: that between two checks is as strong as that between
two objects. What tells them apart is repetition: beyond a purple check and a white one comes a
purple one again. Two borders of a region continue each other if what lies beyond them looks the
same; a chain of such borders, in which both colours return, is a pattern.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slgaussian.masks.merge import adjacency, plane_gap, plane_sums

ALIKE = 12.0
"""CIELAB distance of median colours under which two elements look the same."""
SIZE_RATIO = 2.5
"""Elements that touch differ in area by less than this factor, save where an outline cuts one."""
LARGEST = 0.03
"""Share of the image that an element can have."""
FEWEST = 6
"""Elements of a pattern. Both colours return from four on, but clutter does that by accident."""
FLAT = 0.02
"""Elements that touch are parts of one surface: one plane explains the inverse depth of both, up to
this share of it. It is loose enough for balls and pillars."""


def join_patterns(
    lab: np.ndarray, regions: np.ndarray, depth: np.ndarray | None = None
) -> np.ndarray:
    """Unite the regions that are elements of one pattern.

    Parameters
    ----------
    lab : float32 [H, W, 3]
        CIELAB.
    regions : int32 [H, W]
        Regions 0 .. N-1, or -1.
    depth : float32 [H, W] or None
        Predicted depth, 0 where unknown.

    Returns
    -------
    int32 [H, W]
        Regions 0 .. M-1, M at most N, and -1 in the same places as before.
    """
    count = int(regions.max(initial=-1)) + 1
    if count < FEWEST:
        return regions.copy()
    inside = regions >= 0
    index = regions[inside]
    size = np.bincount(index, minlength=count)
    # Medians: half of a small element's pixels can be blurred with what surrounds it.
    shown = lab[inside]
    color = np.stack([_medians(channel, index, size) for channel in shown.T], 1)
    contrast = np.linalg.norm(color[:, None] - color[None], axis=-1)
    alike = contrast < ALIKE

    edges, length, _ = adjacency(regions, np.zeros(regions.shape, np.float32))
    planes = plane_sums(regions, depth, count)
    a, b = edges.T
    usable = (np.maximum(size[a], size[b]) < LARGEST * regions.size) & ~alike[a, b]
    usable[usable] = [plane_gap(planes[u], planes[v]) < FLAT for u, v in edges[usable]]
    even = np.maximum(size[a], size[b]) < SIZE_RATIO * np.minimum(size[a], size[b])

    core = usable & even
    group = _chains(edges[core], (length * contrast[a, b])[core], alike)
    _take_ends(group, edges[usable], alike, size)
    joined = np.unique(group, return_inverse=True)[1].astype(np.int32)
    return np.where(inside, joined[regions], -1)


def _medians(values: np.ndarray, index: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Median of float32 ``values`` [P] in each region ``index`` [P]; there are ``size`` [N] of it.

    Region and value are one whole number, because those are sorted fast: read as one, a float grows
    with its value, and falls where it is negative unless its other bits are turned over.
    """
    bits = values.view(np.int32)
    keys = (index.astype(np.int64) << 32) + (bits ^ ((bits >> 31) & 0x7FFFFFFF))
    keys.sort()
    bits = keys.astype(np.int32)  # the lower half
    values = (bits ^ ((bits >> 31) & 0x7FFFFFFF)).view(np.float32)
    first = np.cumsum(size) - size
    return (values[first + (size - 1) // 2] + values[first + size // 2]) / 2


def _chains(edges: np.ndarray, weight: np.ndarray, alike: np.ndarray) -> np.ndarray:
    """Group of every region, int64 [N]: its own number, or N + k in the pattern k.

    Every region goes to the chain with which it shares most border, weighed by contrast: the white
    checks of two patterns that touch stay with their own, and the blurs of both colours where four
    checks meet draw none away.
    """
    count = len(alike)
    group = np.arange(count)
    if not len(edges):
        return group
    links = []
    ends = np.concatenate([edges, edges[:, ::-1]])
    number = np.tile(np.arange(len(edges)), 2)
    for region in range(count):
        here = np.flatnonzero(ends[:, 0] == region)
        first, second = np.nonzero(alike[np.ix_(ends[here, 1], ends[here, 1])])
        links.append(np.stack([number[here[first]], number[here[second]]]))
    chain = _components(np.concatenate(links, 1), len(edges))
    border = np.zeros((count, chain.max() + 1))
    for side in (0, 1):
        np.add.at(border, (edges[:, side], chain), weight)
    own = np.where(border.any(1), border.argmax(1), -1)
    kept = (own[edges] == chain[:, None]).all(1)
    pattern = _components(edges[kept].T, count)
    for members in np.split(np.argsort(pattern), np.cumsum(np.bincount(pattern))[:-1]):
        # Both colours return: in "red, white, red" the white does not.
        members = members[alike[np.ix_(members, members)].sum(1) >= 2]
        if len(members) >= FEWEST and not alike[np.ix_(members, members)].all():
            group[members] = count + pattern[members[0]]
    return group


def _take_ends(group: np.ndarray, edges: np.ndarray, alike: np.ndarray, size: np.ndarray) -> None:
    """Add to patterns, in place, the elements that an outline cut small.

    Such an element touches a member and looks like another one beyond it.
    """
    count = len(group)
    ends = np.concatenate([edges, edges[:, ::-1]])
    neighbours = coo_matrix((np.ones(len(ends), bool), tuple(ends.T)), (count, count)).tocsr()
    while True:
        taken = {}
        for new, member in ends[(group[ends[:, 0]] < count) & (group[ends[:, 1]] >= count)]:
            beyond = neighbours[member].indices
            twin = alike[new, beyond] & (group[beyond] == group[member])
            if (twin & (size[new] < SIZE_RATIO * size[beyond])).any():
                taken[new] = group[member]
        if not taken:
            return
        group[list(taken)] = list(taken.values())


def _components(pairs: np.ndarray, count: int) -> np.ndarray:
    """Connected component of each of ``count`` nodes, from pairs [2, P] of linked ones."""
    graph = coo_matrix((np.ones(pairs.shape[1], bool), tuple(pairs)), (count, count))
    return connected_components(graph, directed=False)[1]
