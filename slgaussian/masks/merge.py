"""Binary merge tree over the leaves of an over-segmentation.

Adjacent regions are merged in order of cost. The cost combines the strength of their border, the
differences of colour and texture, the empty share of their joint bounding box and, where depth is
known, the misfit of a joint plane. It grows with the size of the smaller region, so that small
pieces merge early and objects late. :class:`Cues` has the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects

from slgaussian.geometry.boundaries import TEXTURE_CODES, texture_codes
from slgaussian.kernels.jit import kernel

COLOR_STEP = 30.0
"""Distance of mean CIELAB colours at which the colour term saturates."""
PLANE_STEP = 0.05
"""Relative error of inverse depth under a joint plane at which the plane term saturates."""


@dataclass(frozen=True)
class Cues:
    """Weights of the merging cost; the mean strength of the border has weight 1.

    Attributes:
        color, texture, plane, fill: Weights of the distance of mean colours, of the chi-squared
            distance of texture histograms, of the misfit of a joint plane (0 where depth is
            unknown), and of the empty share of the joint bounding box, which favours compact
            regions.
        size_power: Power of the harmonic size of the two regions, a share of the image, that
            multiplies the cost. A high power grows regions evenly; with a low one, small objects
            with strong borders survive longest.
    """

    color: float = 0.3
    texture: float = 0.2
    plane: float = 0.5
    fill: float = 0.0
    size_power: float = 0.25


@dataclass(frozen=True, eq=False)
class MergeTree:
    """Merge order of N leaves.

    Attributes:
        leaves: int32 [H, W] or [V, H, W]. Leaf of every pixel, 0 .. N-1; -1 where there is none.
        parent: int32 [M]. Parent of every node, -1 for a root. Nodes 0 .. N-1 are leaves; parents
            follow children.
        height: float64 [M]. Cost of the merge that created a node, 0 for leaves, at least that of
            its children: the weighted sum of the cues, each 0 to about 1, times the size term of
            :class:`Cues`.
    """

    leaves: np.ndarray
    parent: np.ndarray
    height: np.ndarray

    def cut(self, height: float, max_count: int) -> np.ndarray:
        """Return the nodes of a cut at ``height``, raised until there are at most ``max_count``.

        Returns ascending node indices int64 [K] that together cover every leaf once. K exceeds
        ``max_count`` only if there are more roots.
        """
        merges = np.sort(self.height)[::-1]
        spare = max(max_count - int((self.parent < 0).sum()), 0)
        if spare < len(merges):
            height = max(height, float(merges[spare]))
        above = np.where(self.parent >= 0, self.height[self.parent], np.inf)
        return np.flatnonzero((self.height <= height) & (above > height))

    def labels(self, nodes: np.ndarray) -> np.ndarray:
        """Return the label map of a cut: k + 1 in ``nodes[k]``, 0 without leaf; int32."""
        return np.append(self.places(nodes) + 1, np.int32(0))[self.leaves]

    def places(self, nodes: np.ndarray) -> np.ndarray:
        """Return for every leaf the k of the ``nodes[k]`` that contains it, int32 [N]."""
        place = np.full(len(self.parent) + 1, -1, np.int32)
        place[nodes] = np.arange(len(nodes))
        for node in range(len(self.parent) - 1, -1, -1):
            if place[node] < 0:
                place[node] = place[self.parent[node]]
        return place[: int(self.leaves.max(initial=-1)) + 1]

    def members(self) -> np.ndarray:
        """Return the leaves of each node, bool [M, N]."""
        count = int(self.leaves.max(initial=-1)) + 1
        members = np.eye(len(self.parent), count, dtype=bool)
        for node, parent in enumerate(self.parent):
            if parent >= 0:
                members[parent] |= members[node]
        return members


@dataclass(frozen=True, eq=False)
class LeafSums:
    """Sufficient statistics of N leaves in V views: sums, so that a union is an addition.

    Attributes:
        leaves: int32 [H, W] or [V, H, W]. Leaf of every pixel, 0 .. N-1, or -1.
        edges: int64 [E, 2]
        length, strength: float64 [E]. Leaves that touch, the length of their border and its summed
            strength: :func:`adjacency`.
        size: float64 [N]. Share of the image, the mean over views.
        color: float64 [N, 3]. Mean CIELAB times size.
        histogram: float64 [N, TEXTURE_CODES]. Texture histogram that sums to size.
        sizes: float64 [N, V]. Share of each view, 0 where it does not show the leaf.
        planes: float64 [N, V, 10]. :func:`plane_sums`.
        boxes: float64 [N, V, 4]. Left, top, right and bottom, with an image of area 1; inside out
            where a leaf is not shown.
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
    """Compute the statistics of every leaf.

    Args:
        lab: float32 [H, W, 3]. CIELAB.
        leaves: int32 [H, W]. Leaves 0 .. N-1, or -1.
        boundary: float32 [H, W]. Border strength.
        depth: float32 [H, W] or None. Predicted depth, 0 where unknown.
        count: Number N of leaves, if some are visible in other views only.
        texture: uint8 [H, W], optional. Texture codes of ``lab``, computed by default.
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
    """Combine the statistics of the same N leaves in several views of one size."""
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
    """Merge greedily until no two regions are adjacent; by default with ``Cues()``."""
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
    """Return edges int64 [E, 2] (u < v, sorted), and length and summed strength of each border."""
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
    """Sum 1, u, v, uu, uv, vv, d, du, dv, dd over each leaf, for fits of planes d(u, v).

    ``d`` is inverse depth relative to its median; ``u`` and ``v`` are in units of the width.
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
    """Return left, top, right, bottom of every leaf, float64 [n, 4], for an image area of 1."""
    unit = np.sqrt(leaves.size)
    corners = np.tile([np.inf, np.inf, -np.inf, -np.inf], (n, 1))
    for leaf, window in enumerate(find_objects(leaves + 1, n)):
        if window is not None:
            y, x = window
            corners[leaf] = x.start, y.start, x.stop, y.stop
    return corners / unit


@kernel
def _plane_error(a, b, share):
    """Return the squared residuals of the best plane for :func:`plane_sums` ``a + share * b``."""
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
    """Return the misfit of one plane for two regions over two planes, relative to inverse depth.

    ``a`` and ``b`` are rows of :func:`plane_sums`; 0 if the depth of either is unknown.
    """
    if a[0] == 0 or b[0] == 0:
        return 0.0
    worse = _plane_error(a, b, 1.0) - _plane_error(a, b, 0.0) - _plane_error(b, a, 0.0)
    return np.sqrt(max(worse, 0.0) / min(a[0], b[0])) * (a[0] + b[0]) / (a[6] + b[6])


@kernel
def _cost(a, b, border, size, color, histogram, sizes, planes, boxes, weights, power):
    """Return the cost of merging regions a and b; ``weights`` are border, color, texture, plane
    and fill."""
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
    """Fill ``parent`` and ``height`` and return the number of nodes; modifies all other arrays.

    ``node`` [N] is the node of each region, ``edge_to`` [N] is -1, and ``cost`` [E] is scratch.
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
        # Scalar loops: row operations take Numba seconds to compile.
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
        # Rewrite the edges in place: edges of `gone` move to `keep`, and parallel edges merge.
        write = 0
        for e in range(live):
            a, b = edges[e, 0], edges[e, 1]
            if e == best:
                continue
            starts, ends = a in (keep, gone), b in (keep, gone)
            if starts or ends:
                neighbour = b if starts else a
                if edge_to[neighbour] >= 0:
                    twin = edge_to[neighbour]
                    length[twin] += length[e]
                    strength[twin] += strength[e]
                    continue
                edge_to[neighbour] = write
                a, b = min(keep, neighbour), max(keep, neighbour)
            edges[write, 0], edges[write, 1] = a, b
            length[write], strength[write], cost[write] = length[e], strength[e], cost[e]
            write += 1
        live = write
        for e in range(live):
            a, b = edges[e, 0], edges[e, 1]
            if a == keep or b == keep:
                edge_to[b if a == keep else a] = -1
                border = strength[e] / length[e]
                cost[e] = _cost(
                    a, b, border, size, color, histogram, sizes, planes, boxes, weights, power
                )
    return count
