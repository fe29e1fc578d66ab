"""Binary merge tree over the leaves of an over-segmentation.

Adjacent regions are merged in order of cost, which combines the cues that :class:`Cues` weights. It
grows with the size of the smaller region, so that small pieces merge early and objects late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects

from slgaussian.geometry.boundaries import TEXTURE_CODES, texture_codes
from slgaussian.kernels.jit import kernel

COLOUR_STEP = 30.0
"""Distance of mean CIELAB colours at which the colour term saturates."""
PLANE_STEP = 0.05
"""Relative error of inverse depth under a joint plane at which the plane term saturates."""


@dataclass(frozen=True)
class Cues:
    """Weights of the merging cost; the mean strength of the border has weight 1.

    Attributes:
        colour, texture, plane, fill: Weights of the distance of mean colours, of the chi-squared
            distance of texture histograms, of the misfit of a joint plane (0 where depth is
            unknown), and of the empty share of the joint bounding box.
        size_power: Power of the harmonic size of the two regions, a share of the image, that
            multiplies the cost. A high power grows regions evenly.
    """

    colour: float = 0.3
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
            its children.
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
        edges, borders: int64 [E, 2], float64 [E, 2]. As :func:`adjacency`.
        means: float64 [N, 31]. Mean over the views of: the share of the image; CIELAB and the
            texture histogram, summed over the leaf and divided by the pixels of the image.
        views: float64 [N, V, 11]. Share of each view, 0 where it does not show the leaf, and
            :func:`plane_sums`.
        boxes: float64 [N, V, 4]. Left, top, right and bottom, with an image of area 1; inside out
            where a leaf is not shown.
    """

    leaves: np.ndarray
    edges: np.ndarray
    borders: np.ndarray
    means: np.ndarray
    views: np.ndarray
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
    size = np.bincount(index, minlength=n)
    colour = [np.bincount(index, lab[inside, c], n) for c in range(3)]
    codes = (texture_codes(lab[..., 0]) if texture is None else texture)[inside]
    histogram = np.bincount(index * TEXTURE_CODES + codes, minlength=n * TEXTURE_CODES)
    means = np.column_stack([size, *colour, histogram.reshape(n, TEXTURE_CODES)]) / leaves.size
    views = np.column_stack([means[:, 0], plane_sums(leaves, depth, n)])
    boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (n, 1))
    for leaf, window in enumerate(find_objects(leaves + 1, n)):
        if window is not None:
            y, x = window
            boxes[leaf] = x.start, y.start, x.stop, y.stop
    boxes /= np.sqrt(leaves.size)
    return LeafSums(leaves, *adjacency(leaves, boundary), means, views[:, None], boxes[:, None])


def joint_sums(views: Sequence[LeafSums]) -> LeafSums:
    """Combine the statistics of the same N leaves in several views of one size."""
    leaves = np.stack([view.leaves for view in views])
    edges, borders = (np.concatenate([getattr(v, n) for v in views]) for n in ("edges", "borders"))
    means = np.mean([view.means for view in views], 0)
    columns = (np.concatenate([getattr(v, n) for v in views], 1) for n in ("views", "boxes"))
    return LeafSums(leaves, *_sum_borders(edges, borders, len(means)), means, *columns)


def build_tree(sums: LeafSums, cues: Cues | None = None) -> MergeTree:
    """Merge greedily until no two regions are adjacent; by default with ``Cues()``."""
    cues = cues or Cues()
    n = len(sums.means)
    parent, height = np.full(2 * n, -1, np.int32), np.zeros(2 * n)
    scratch = np.arange(n), np.full(n, -1, np.int64), np.empty(len(sums.edges))
    tables = sums.edges, sums.borders, sums.means, sums.views, sums.boxes
    weights = np.array([cues.colour, cues.texture, cues.plane, cues.fill])
    copies = [table.copy() for table in tables]
    count = _merge(parent, height, *scratch, *copies, weights, cues.size_power)
    return MergeTree(sums.leaves, parent[:count], height[:count])


def adjacency(leaves: np.ndarray, boundary: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the leaves that touch.

    Returns:
        edges: int64 [E, 2]. Pairs of leaves, u < v, sorted.
        borders: float64 [E, 2]. Length of their common border, and its summed strength.
    """
    edges, strengths = [], []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        pairs = np.stack([leaves[a], leaves[b]], -1)
        touch = (pairs[..., 0] != pairs[..., 1]) & (pairs >= 0).all(-1)
        edges.append(np.sort(pairs[touch], 1))
        strengths.append(np.maximum(boundary[a], boundary[b])[touch])
    strength = np.concatenate(strengths)
    borders = np.stack([np.ones_like(strength), strength], 1)
    return _sum_borders(np.concatenate(edges), borders, int(leaves.max(initial=-1)) + 1)


def _sum_borders(
    edges: np.ndarray, borders: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the borders of equal edges between ``count`` leaves."""
    keys, inverse = np.unique(
        edges[:, 0].astype(np.int64) * count + edges[:, 1], return_inverse=True
    )
    sums = [np.bincount(inverse, border, len(keys)) for border in borders.T]
    return np.stack(np.divmod(keys, max(count, 1)), 1), np.stack(sums, 1)


def plane_sums(leaves: np.ndarray, depth: np.ndarray | None, n: int) -> np.ndarray:
    """Sum 1, u, v, uu, uv, vv, d, du, dv, dd over each leaf, float64 [n, 10], for planes d(u, v).

    ``d`` is inverse depth relative to its median; ``u`` and ``v`` are in units of the width.
    """
    if depth is None or not (depth > 0).any():
        return np.zeros((n, 10))
    use = (leaves >= 0) & (depth > 0)
    d = np.median(depth[use]) / depth[use].astype(np.float64)
    v, u = (axis / leaves.shape[1] for axis in np.nonzero(use))
    terms = (np.ones_like(d), u, v, u * u, u * v, v * v, d, d * u, d * v, d * d)
    return np.stack([np.bincount(leaves[use], term, n) for term in terms], 1)


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
def _cost(a, b, border, means, views, boxes, weights, power):
    """Return the cost of merging regions a and b, whose common border has strength ``border``.

    ``weights`` are those of colour, texture, plane and fill.
    """
    size_a, size_b = means[a, 0], means[b, 0]
    colour_gap = texture_gap = 0.0
    for c in range(1, 4):
        step = means[a, c] / size_a - means[b, c] / size_b
        colour_gap += step * step
    for k in range(4, means.shape[1]):
        p, q = means[a, k] / size_a, means[b, k] / size_b
        if p + q > 0:
            texture_gap += (p - q) * (p - q) / (p + q)
    misfit, empty, both, some = 0.0, 0.0, 0, 0
    for v in range(views.shape[1]):
        share_a, share_b = views[a, v, 0], views[b, v, 0]
        if share_a > 0 and share_b > 0:
            misfit += min(plane_gap(views[a, v, 1:], views[b, v, 1:]) / PLANE_STEP, 1.0)
            both += 1
        if share_a > 0 or share_b > 0:
            wide = max(boxes[a, v, 2], boxes[b, v, 2]) - min(boxes[a, v, 0], boxes[b, v, 0])
            high = max(boxes[a, v, 3], boxes[b, v, 3]) - min(boxes[a, v, 1], boxes[b, v, 1])
            empty += 1 - (share_a + share_b) / (wide * high)
            some += 1
    cost = border + weights[0] * min(np.sqrt(colour_gap) / COLOUR_STEP, 1.0)
    cost += weights[1] * texture_gap
    cost += weights[2] * misfit / max(both, 1)
    cost += weights[3] * empty / some
    return cost * (size_a * size_b / (size_a + size_b)) ** power


@kernel
def _merge(
    parent, height, node, edge_to, cost, edges, borders, means, views, boxes, weights, power
):
    """Fill ``parent`` and ``height`` and return the number of nodes; modifies all other arrays.

    ``node`` [N] is the node of each region, ``edge_to`` [N] is -1, and ``cost`` [E] is scratch.
    """
    live, count = len(edges), len(means)
    for e in range(live):
        border = borders[e, 1] / borders[e, 0]
        cost[e] = _cost(edges[e, 0], edges[e, 1], border, means, views, boxes, weights, power)
    while live > 0:
        best = 0
        for e in range(1, live):
            if cost[e] < cost[best]:
                best = e
        keep, gone = edges[best, 0], edges[best, 1]
        # Scalar loops: row operations take Numba seconds to compile.
        for k in range(means.shape[1]):
            means[keep, k] += means[gone, k]
        for v in range(views.shape[1]):
            for k in range(views.shape[2]):
                views[keep, v, k] += views[gone, v, k]
            for k in range(2):
                boxes[keep, v, k] = min(boxes[keep, v, k], boxes[gone, v, k])
                boxes[keep, v, k + 2] = max(boxes[keep, v, k + 2], boxes[gone, v, k + 2])
        height[count] = max(cost[best], height[node[keep]], height[node[gone]])
        parent[node[keep]] = parent[node[gone]] = count
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
                twin = edge_to[neighbour]
                if twin >= 0:
                    borders[twin, 0] += borders[e, 0]
                    borders[twin, 1] += borders[e, 1]
                    continue
                edge_to[neighbour] = write
                a, b = min(keep, neighbour), max(keep, neighbour)
            edges[write, 0], edges[write, 1], cost[write] = a, b, cost[e]
            borders[write, 0], borders[write, 1] = borders[e, 0], borders[e, 1]
            write += 1
        live = write
        for e in range(live):
            a, b = edges[e, 0], edges[e, 1]
            if a == keep or b == keep:
                edge_to[b if a == keep else a] = -1
                border = borders[e, 1] / borders[e, 0]
                cost[e] = _cost(a, b, border, means, views, boxes, weights, power)
    return count
