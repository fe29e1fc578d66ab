"""Merging of the elements of repeated patterns, such as checks, stripes and tiles, into a region.

The border between two checks is as strong as that between two objects. A pattern is distinguished
by repetition: next to a purple check and a white one is another purple one. Two borders of a region
are linked if the regions beyond them have similar colours; a chain of linked borders in which both
colours recur is a pattern.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from slgaussian.masks.merge import adjacency, plane_gap, plane_sums

COLOUR_TOLERANCE = 12.0
"""CIELAB distance of median colours below which the colours of two elements are equal."""
MAX_SIZE_RATIO = 2.5
"""Largest ratio of the areas of adjacent elements, except where an outline cuts one."""
MAX_ELEMENT_SHARE = 0.03
"""Largest share of the image of an element."""
MIN_ELEMENTS = 6
"""Smallest number of elements of a pattern. Four elements suffice for both colours to recur, but
that happens by accident in clutter."""
PLANE_TOLERANCE = 0.02
"""Largest relative error of inverse depth under one plane for adjacent elements, which must lie on
one surface. It allows the curvature of balls and pillars."""


def join_patterns(
    lab: np.ndarray, regions: np.ndarray, depth: np.ndarray | None = None
) -> np.ndarray:
    """Merge the regions that are elements of one pattern.

    Args:
        lab: float32 [H, W, 3]. CIELAB.
        regions: int32 [H, W]. Regions 0 .. N-1, or -1.
        depth: float32 [H, W] or None. Predicted depth, 0 where unknown.

    Returns:
        int32 [H, W]: Regions 0 .. M-1, M at most N, and -1 in the same places as before.
    """
    count = int(regions.max(initial=-1)) + 1
    if count < MIN_ELEMENTS:
        return regions.copy()
    inside = regions >= 0
    index = regions[inside]
    size = np.bincount(index, minlength=count)
    # Medians: up to half of a small element's pixels can be blurred with its surroundings.
    pixels = lab[inside][np.argsort(index, kind="stable")]
    colour = np.array([np.median(part, 0) for part in np.split(pixels, np.cumsum(size)[:-1])])
    contrast = np.linalg.norm(colour[:, None] - colour[None], axis=-1)
    similar = contrast < COLOUR_TOLERANCE

    edges, borders = adjacency(regions, np.zeros(regions.shape, np.float32))
    planes = plane_sums(regions, depth, count)
    a, b = edges.T
    usable = (np.maximum(size[a], size[b]) < MAX_ELEMENT_SHARE * regions.size) & ~similar[a, b]
    usable[usable] = [plane_gap(planes[u], planes[v]) < PLANE_TOLERANCE for u, v in edges[usable]]
    similar_size = np.maximum(size[a], size[b]) < MAX_SIZE_RATIO * np.minimum(size[a], size[b])

    core = usable & similar_size
    group = _chains(edges[core], (borders[:, 0] * contrast[a, b])[core], similar)
    _take_ends(group, edges[usable], similar, size)
    joined = np.unique(group, return_inverse=True)[1].astype(np.int32)
    return np.where(inside, joined[regions], -1)


def _chains(edges: np.ndarray, weight: np.ndarray, similar: np.ndarray) -> np.ndarray:
    """Return the group of every region, int64 [N]: its own number, or N + k in the pattern k.

    Every region joins the chain with the longest common border, weighted by contrast.
    """
    count = len(similar)
    group = np.arange(count)
    if not len(edges):
        return group
    links = []
    ends = np.concatenate([edges, edges[:, ::-1]])
    number = np.tile(np.arange(len(edges)), 2)
    for region in range(count):
        incident = np.flatnonzero(ends[:, 0] == region)
        first, second = np.nonzero(similar[np.ix_(ends[incident, 1], ends[incident, 1])])
        links.append(np.stack([number[incident[first]], number[incident[second]]]))
    chain = _components(np.concatenate(links, 1), len(edges))
    border = np.zeros((count, chain.max() + 1))
    for side in (0, 1):
        np.add.at(border, (edges[:, side], chain), weight)
    best_chain = np.where(border.any(1), border.argmax(1), -1)
    supported = (best_chain[edges] == chain[:, None]).all(1)
    pattern = _components(edges[supported].T, count)
    for members in np.split(np.argsort(pattern), np.cumsum(np.bincount(pattern))[:-1]):
        # Both colours must recur: in "red, white, red" white does not.
        members = members[similar[np.ix_(members, members)].sum(1) >= 2]
        if len(members) >= MIN_ELEMENTS and not similar[np.ix_(members, members)].all():
            group[members] = count + pattern[members[0]]
    return group


def _take_ends(group: np.ndarray, edges: np.ndarray, similar: np.ndarray, size: np.ndarray) -> None:
    """Add truncated elements, in place: they touch a member and look like one beyond it."""
    count = len(group)
    ends = np.concatenate([edges, edges[:, ::-1]])
    neighbours = coo_matrix((np.ones(len(ends), bool), tuple(ends.T)), (count, count)).tocsr()
    while True:
        joined = {}
        for new, member in ends[(group[ends[:, 0]] < count) & (group[ends[:, 1]] >= count)]:
            beyond = neighbours[member].indices
            twin = similar[new, beyond] & (group[beyond] == group[member])
            if (twin & (size[new] < MAX_SIZE_RATIO * size[beyond])).any():
                joined[new] = group[member]
        if not joined:
            return
        group[list(joined)] = list(joined.values())


def _components(pairs: np.ndarray, count: int) -> np.ndarray:
    """Return the connected component of each of ``count`` nodes, from pairs [2, P] of links."""
    graph = coo_matrix((np.ones(pairs.shape[1], bool), tuple(pairs)), (count, count))
    return connected_components(graph, directed=False)[1]
