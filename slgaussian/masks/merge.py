"""A binary merge tree over the leaves of an over-segmentation.

Neighbouring regions are united cheapest first. The cost weighs the boundary between them, how
differently they are coloured and textured, how badly the two fill a box and, where depth is known,
how badly one plane explains both; it grows with the size of the smaller region, so that crumbs go
early and things stay apart. How much each counts is a :class:`Cues`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects

from slgaussian.geometry.boundaries import TEXTURE_CODES, texture_codes
from slgaussian.kernels.jit import kernel

COLOR_STEP = 30.0
"""Distance of mean CIELAB colours that counts as one full unit of difference."""
PLANE_STEP = 0.05
"""Relative error of inverse depth, under one joint plane, that counts as one full unit."""


@dataclass(frozen=True)
class Cues:
    """What counts in a merge, and how much; the mean strength of the border between counts 1.

    Attributes
    ----------
    color, texture, plane, fill : float
        Weights of the distance of mean colours, the chi-squared distance of texture histograms, the
        misfit of one joint plane (nothing where no depth is known), and the share of their joint
        box that the two regions leave empty, which favours compact ones.
    size_power : float
        The cost is multiplied by this power of the harmonic size of the two regions, a share of the
        image. High, regions grow evenly; low, small things with a strong border stay to the end.
    """

    color: float = 0.3
    texture: float = 0.2
    plane: float = 0.5
    fill: float = 0.0
    size_power: float = 0.25


@dataclass(frozen=True, eq=False)
class MergeTree:
    """The order in which N leaves grow together.

    Attributes
    ----------
    leaves : int32 [H, W] or [V, H, W]
        Leaf of every pixel, 0 .. N-1; -1 where there is none.
    parent : int32 [M]
        Parent of every node, -1 for a root. Nodes 0 .. N-1 are leaves; parents follow children.
    height : float64 [M]
        Cost at which a node was made, 0 for leaves; never below that of its children. It is the
        weighted sum of the cues, each 0 to about 1, times the size term of :class:`Cues`.
    """

    leaves: np.ndarray
    parent: np.ndarray
    height: np.ndarray

    def cut(self, height: float, most: int) -> np.ndarray:
        """The largest nodes not above ``height``; the cut rises until they are at most ``most``.

        Returns int64 [K] node indices, ascending; together they cover every leaf once. K exceeds
        ``most`` only where more roots than that exist.
        """
        merges = np.sort(self.height)[::-1]
        spare = max(most - int((self.parent < 0).sum()), 0)
        if spare < len(merges):
            height = max(height, float(merges[spare]))
        above = np.where(self.parent >= 0, self.height[self.parent], np.inf)
        return np.flatnonzero((self.height <= height) & (above > height))

    def labels(self, nodes: np.ndarray) -> np.ndarray:
        """Paint nodes of a cut: int32 as ``leaves``, k + 1 in ``nodes[k]``, 0 where no leaf is."""
        return np.append(self.places(nodes) + 1, np.int32(0))[self.leaves]

    def places(self, nodes: np.ndarray) -> np.ndarray:
        """For every leaf, k of the ``nodes[k]`` of a cut that holds it: int32 [N]."""
        place = np.full(len(self.parent) + 1, -1, np.int32)
        place[nodes] = np.arange(len(nodes))
        for node in range(len(self.parent) - 1, -1, -1):
            if place[node] < 0:
                place[node] = place[self.parent[node]]
        return place[: int(self.leaves.max(initial=-1)) + 1]

    def members(self, nodes: np.ndarray) -> np.ndarray:
        """Which leaves make up each of the ``nodes`` [K]: bool [K, N]."""
        spans = np.zeros((len(self.parent) + 1, 3), np.int64)  # leaves below, first, next free
        below, first, free = spans.T
        count = int(self.leaves.max(initial=-1)) + 1
        below[:count] = 1
        for node, parent in enumerate(self.parent):
            below[parent] += below[node]
        # Leaves in an order in which every node holds a run of them; the last row is above roots.
        for node in range(len(self.parent) - 1, -1, -1):
            parent = self.parent[node]
            first[node] = free[node] = free[parent]
            free[parent] += below[node]
        place, start = first[:count], first[nodes, None]
        return (place >= start) & (place < start + below[nodes, None])


@dataclass(frozen=True, eq=False)
class LeafSums:
    """All that merging knows about N leaves in V views: sums, so that a union is an addition.

    Attributes
    ----------
    leaves : int32 [H, W] or [V, H, W]
        Leaf of every pixel, 0 .. N-1, or -1.
    edges : int64 [E, 2]
    length, strength : float64 [E]
        Leaves that touch, the length of their border and its summed strength: :func:`adjacency`.
    size : float64 [N]
        Share of the image, the mean over views.
    color : float64 [N, 3]
        Mean CIELAB times size.
    histogram : float64 [N, TEXTURE_CODES]
        Texture histogram that sums to size.
    sizes : float64 [N, V]
        Share of each view, 0 where it does not show the leaf.
    planes : float64 [N, V, 10]
        :func:`plane_sums`.
    boxes : float64 [N, V, 4]
        Left, top, right and bottom, with an image of area 1; inside out where a leaf is not shown.
    """

    leaves: np.ndarray
    edges: np.ndarray
    length: np.ndarray
    strength: np.ndarray
    size: np.ndarray
    color: np.ndarray
    histogram: np.ndarray
    sizes: np.ndarray
    planes: np.ndarray
    boxes: np.ndarray


def leaf_sums(
    lab: np.ndarray,
    leaves: np.ndarray,
    boundary: np.ndarray,
    depth: np.ndarray | None = None,
    count: int | None = None,
    texture: np.ndarray | None = None,
) -> LeafSums:
    """Sum up the pixels of every leaf.

    Parameters
    ----------
    lab : float32 [H, W, 3]
        CIELAB.
    leaves : int32 [H, W]
        Leaves 0 .. N-1, or -1.
    boundary : float32 [H, W]
        Border strength.
    depth : float32 [H, W] or None
        Predicted depth, 0 where unknown.
    count : int, optional
        The number N of leaves, if some of them are shown in other views only.
    texture : uint8 [H, W], optional
        The texture codes of ``lab``, where they are known.
    """
    n = int(leaves.max(initial=-1)) + 1 if count is None else count
    inside = leaves >= 0
    index = leaves[inside]
    size = np.bincount(index, minlength=n).astype(np.float64)
    color = np.stack([np.bincount(index, lab[inside, c], n) for c in range(3)], 1)
    codes = (texture_codes(lab[..., 0]) if texture is None else texture)[inside]
    histogram = np.bincount(index * TEXTURE_CODES + codes, minlength=n * TEXTURE_CODES)
    edges, length, strength = adjacency(leaves, boundary)
    return LeafSums(
        leaves,
        edges,
        length,
        strength,
        size / leaves.size,
        color / leaves.size,
        histogram.reshape(n, TEXTURE_CODES) / leaves.size,
        size[:, None] / leaves.size,
        plane_sums(leaves, depth, n)[:, None],
        _boxes(leaves, n)[:, None],
    )


def joint_sums(views: Sequence[LeafSums]) -> LeafSums:
    """The same N leaves in several views of one size, seen as one: each shown in any of them."""
    leaves = np.stack([view.leaves for view in views])
    count = len(views[0].size)
    edges = np.concatenate([view.edges for view in views])
    keys, inverse = np.unique(edges[:, 0] * count + edges[:, 1], return_inverse=True)
    length, strength = (
        np.bincount(inverse, np.concatenate([getattr(view, name) for view in views]), len(keys))
        for name in ("length", "strength")
    )
    means = (
        np.mean([getattr(view, name) for view in views], 0)
        for name in ("size", "color", "histogram")
    )
    beside = (
        np.concatenate([getattr(view, name) for view in views], 1)
        for name in ("sizes", "planes", "boxes")
    )
    edges = np.stack([keys // max(count, 1), keys % max(count, 1)], 1)
    return LeafSums(leaves, edges, length, strength, *means, *beside)


def build_tree(sums: LeafSums, cues: Cues | None = None) -> MergeTree:
    """Merge greedily until no two regions touch; without ``cues`` by the default ones."""
    cues = cues or Cues()
    n = len(sums.size)
    parent, height = np.full(2 * n, -1, np.int32), np.zeros(2 * n)
    count = _merge(
        parent,
        height,
        np.arange(n),
        np.full(n, -1, np.int64),
        np.empty(len(sums.edges)),
        sums.edges.copy(),
        sums.length.copy(),
        sums.strength.copy(),
        sums.size.copy(),
        sums.color.copy(),
        sums.histogram.copy(),
        sums.sizes.copy(),
        sums.planes.copy(),
        sums.boxes.copy(),
        np.array([1.0, cues.color, cues.texture, cues.plane, cues.fill]),
        cues.size_power,
    )
    return MergeTree(sums.leaves, parent[:count], height[:count])


def adjacency(leaves, boundary):
    """Edges int64 [E, 2] (u < v, sorted), the length of each border and its summed strength."""
    n = int(leaves.max(initial=-1)) + 1
    keys, strengths = [], []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        p, q = leaves[a].astype(np.int64), leaves[b].astype(np.int64)
        touch = (p != q) & (p >= 0) & (q >= 0)
        keys.append(np.minimum(p, q)[touch] * n + np.maximum(p, q)[touch])
        strengths.append(np.maximum(boundary[a], boundary[b])[touch])
    unique, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    edges = np.stack([unique // max(n, 1), unique % max(n, 1)], 1)
    length = np.bincount(inverse, minlength=len(unique)).astype(np.float64)
    return edges, length, np.bincount(inverse, np.concatenate(strengths), len(unique))


def plane_sums(leaves, depth, n):
    """Sums of 1, u, v, uu, uv, vv, d, du, dv, dd per leaf: all that a plane fit d(u, v) needs.

    ``d`` is inverse depth relative to its median, ``u`` and ``v`` are in units of the width.
    """
    sums = np.zeros((n, 10))
    if depth is None or not (depth > 0).any():
        return sums
    use = (leaves >= 0) & (depth > 0)
    index = leaves[use]
    d = np.median(depth[use]) / depth[use].astype(np.float64)
    v, u = (axis / leaves.shape[1] for axis in np.nonzero(use))
    terms = (np.ones_like(d), u, v, u * u, u * v, v * v, d, d * u, d * v, d * d)
    for column, term in enumerate(terms):
        sums[:, column] = np.bincount(index, term, n)
    return sums


def _boxes(leaves, n):
    """Left, top, right, bottom of every leaf, float64 [n, 4], in units in which the area is 1."""
    unit = np.sqrt(leaves.size)
    corners = np.tile([np.inf, np.inf, -np.inf, -np.inf], (n, 1))
    for leaf, found in enumerate(find_objects(leaves + 1, n)):
        if found is not None:
            y, x = found
            corners[leaf] = x.start, y.start, x.stop, y.stop
    return corners / unit


@kernel
def _plane_error(a, b, share):
    """Sum of squared residuals of the best plane, from sums of :func:`plane_sums`: a + share b."""
    count = a[0] + share * b[0]
    if count < 3:
        return 0.0
    x, y, d = a[1] + share * b[1], a[2] + share * b[2], a[6] + share * b[6]
    u, v = x / count, y / count
    ridge = 1e-6 * count
    uu = a[3] + share * b[3] - u * x + ridge
    uv = a[4] + share * b[4] - u * y
    vv = a[5] + share * b[5] - v * y + ridge
    du, dv = a[7] + share * b[7] - u * d, a[8] + share * b[8] - v * d
    dd = a[9] + share * b[9] - d * d / count
    det = uu * vv - uv * uv
    explained = (du * du * vv - 2 * du * dv * uv + dv * dv * uu) / det
    return max(dd - explained, 0.0)


@kernel
def plane_gap(a, b):
    """By how much, relative to inverse depth, one plane explains two regions worse than two do.

    ``a`` and ``b`` are rows of :func:`plane_sums`; 0 where the depth of either is unknown.
    """
    if a[0] == 0 or b[0] == 0:
        return 0.0
    worse = _plane_error(a, b, 1.0) - _plane_error(a, b, 0.0) - _plane_error(b, a, 0.0)
    return np.sqrt(max(worse, 0.0) / min(a[0], b[0])) * (a[0] + b[0]) / (a[6] + b[6])


@kernel
def _cost(a, b, border, size, color, histogram, sizes, planes, boxes, weights, power):
    """Cost of uniting regions a and b; weights are those of border, color, texture, plane, fill."""
    cost = weights[0] * border
    color_gap = 0.0
    for c in range(3):
        step = color[a, c] / size[a] - color[b, c] / size[b]
        color_gap += step * step
    cost += weights[1] * min(np.sqrt(color_gap) / COLOR_STEP, 1.0)
    texture_gap = 0.0
    for k in range(histogram.shape[1]):
        p, q = histogram[a, k] / size[a], histogram[b, k] / size[b]
        if p + q > 0:
            texture_gap += (p - q) * (p - q) / (p + q)
    cost += weights[2] * texture_gap
    misfit, empty, both, some = 0.0, 0.0, 0, 0
    for v in range(sizes.shape[1]):
        if sizes[a, v] > 0 and sizes[b, v] > 0:
            misfit += min(plane_gap(planes[a, v], planes[b, v]) / PLANE_STEP, 1.0)
            both += 1
        if sizes[a, v] > 0 or sizes[b, v] > 0:
            wide = max(boxes[a, v, 2], boxes[b, v, 2]) - min(boxes[a, v, 0], boxes[b, v, 0])
            high = max(boxes[a, v, 3], boxes[b, v, 3]) - min(boxes[a, v, 1], boxes[b, v, 1])
            empty += 1 - (sizes[a, v] + sizes[b, v]) / (wide * high)
            some += 1
    cost += weights[3] * misfit / max(both, 1)
    cost += weights[4] * empty / some
    return cost * (size[a] * size[b] / (size[a] + size[b])) ** power


@kernel
def _merge(
    parent, height, node, edge_to, cost, edges, length, strength, size, color, histogram, sizes,
    planes, boxes, weights, power,
):  # fmt: skip
    """Fill ``parent`` and ``height``, and say how many nodes there are; all else is used up.

    ``node`` [N] is the node that a region has become, ``edge_to`` [N] is -1, and ``cost`` [E] room.
    """
    live, count = edges.shape[0], size.shape[0]
    for e in range(live):
        a, b = edges[e, 0], edges[e, 1]
        border = strength[e] / length[e]
        cost[e] = _cost(a, b, border, size, color, histogram, sizes, planes, boxes, weights, power)
    while live > 0:
        best = 0
        for e in range(1, live):
            if cost[e] < cost[best]:
                best = e
        keep, gone = edges[best, 0], edges[best, 1]
        # Loops over numbers: those over rows would take Numba seconds to compile.
        size[keep] += size[gone]
        for c in range(color.shape[1]):
            color[keep, c] += color[gone, c]
        for k in range(histogram.shape[1]):
            histogram[keep, k] += histogram[gone, k]
        for v in range(sizes.shape[1]):
            sizes[keep, v] += sizes[gone, v]
            for k in range(planes.shape[2]):
                planes[keep, v, k] += planes[gone, v, k]
            for k in range(2):
                boxes[keep, v, k] = min(boxes[keep, v, k], boxes[gone, v, k])
                boxes[keep, v, k + 2] = max(boxes[keep, v, k + 2], boxes[gone, v, k + 2])
        height[count] = max(cost[best], height[node[keep]], height[node[gone]])
        parent[node[keep]] = count
        parent[node[gone]] = count
        node[keep] = count
        count += 1
        # Rewrite the edges in place: those of `gone` go to `keep`, and doubled ones are joined.
        kept = 0
        for e in range(live):
            a, b = edges[e, 0], edges[e, 1]
            if e == best:
                continue
            starts, ends = a in (keep, gone), b in (keep, gone)
            if starts or ends:
                other = b if starts else a
                if edge_to[other] >= 0:
                    twin = edge_to[other]
                    length[twin] += length[e]
                    strength[twin] += strength[e]
                    continue
                edge_to[other] = kept
                a, b = min(keep, other), max(keep, other)
            edges[kept, 0], edges[kept, 1] = a, b
            length[kept], strength[kept], cost[kept] = length[e], strength[e], cost[e]
            kept += 1
        live = kept
        for e in range(live):
            a, b = edges[e, 0], edges[e, 1]
            if a == keep or b == keep:
                edge_to[b if a == keep else a] = -1
                border = strength[e] / length[e]
                cost[e] = _cost(
                    a, b, border, size, color, histogram, sizes, planes, boxes, weights, power
                )
    return count
