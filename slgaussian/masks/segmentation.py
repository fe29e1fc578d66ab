"""The merge tree of an image over watershed leaves, the basis of the proposer ``regions``.

The elements of a repeated pattern, such as checks, stripes or tiles, are merged first, as the
border between two checks is as strong as that between two objects. A pattern is distinguished by
repetition: next to a purple check and a white one is another purple one. Two borders of a region
are linked if the regions beyond them have similar colours; a chain of linked borders in which both
colours recur is a pattern.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from skimage.segmentation import watershed

from slgaussian.geometry import SeenView
from slgaussian.masks import merge
from slgaussian.masks.merge import Cues, MergeTree, build_tree, leaf_sums, plane_gap

LEAF_WINDOW = 7
"""Side in pixels of the window in which a minimum of the border strength seeds a leaf."""

PATTERN_CUT_HEIGHT = 0.12
"""Height of the cut, far below that of objects, at which repeated patterns are detected."""

CUES = (
    Cues(),
    Cues(colour=0.0, texture=0.4, plane=0.25, fill=0.2, size_power=0.6),
    Cues(plane=0.25, fill=0.5, size_power=0.1),
)
"""Cues of three complementary trees: objects; even growth without colour, for objects of many
colours; compact regions, of which small ones survive long."""

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


def grow_tree(frame: SeenView, region: np.ndarray | None = None) -> MergeTree:
    """Build the merge tree of a view.

    Arguments are as in :meth:`slgaussian.masks.regions.Regions.propose`. The leaves are the regions
    of a low cut of a first tree, with repeated patterns merged (:func:`join_patterns`).
    """
    lab, depth, boundary = frame.view.lab, frame.depth, frame.boundary
    leaves = watershed_leaves(boundary)
    if region is not None:
        leaves = np.where(region, leaves, -1)
        packed = np.unique(leaves[region], return_inverse=True)[1]
        leaves[region] = packed.astype(np.int32)
    fine = build_tree(leaf_sums(lab, leaves, boundary, depth, texture=frame.texture))
    elements = fine.labels(fine.cut(PATTERN_CUT_HEIGHT, leaves.size)) - 1
    joined = join_patterns(lab, elements, depth)
    return build_tree(leaf_sums(lab, joined, boundary, depth, texture=frame.texture))


def watershed_leaves(boundary: np.ndarray) -> np.ndarray:
    """Compute watershed basins of a border strength map [H, W]: leaves int32 [H, W], 0 .. N-1."""
    smooth = cv2.GaussianBlur(boundary, (0, 0), 1.0)
    seeds, _ = ndimage.label(smooth == ndimage.minimum_filter(smooth, LEAF_WINDOW))
    return watershed(smooth, seeds).astype(np.int32) - 1


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

    edges, borders = merge.adjacency(regions, np.zeros(regions.shape, np.float32))
    planes = merge.plane_sums(regions, depth, count)
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
