"""Fusion of the views: a choice of views that draw a surface, and its common colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.cameras.relative import Relative
from slgaussian.predict.depth_completion import AGREES, IN_FRONT, cross_check
from slgaussian.predict.view_graph import Link, ViewGraph

MAX_COPIES = 2
"""Largest number of views that draw one surface. On a forward-facing capture of eight views one is
0.3 dB worse, and all eight are 1 dB worse."""

FEATHER_WIDTH = 16.0
"""Distance from the image border, pixels, over which the blending weight of a view rises to 1, so
that no seam appears where its image ends."""


def select_pixels(
    graph: ViewGraph,
    inverse_depths: Sequence[np.ndarray],
    confirmed: Sequence[np.ndarray],
    steps: Sequence[float],
) -> list[np.ndarray]:
    """Select the pixels of each view that add a surface, V of bool [H, W].

    With two views all pixels are selected. With more, a view without confirmed depth is skipped,
    and a guessed pixel is dropped where any view has confirmed a surface behind it. The first two
    views keep the rest. Every later view keeps the pixels of surfaces that earlier views draw less
    than :data:`MAX_COPIES` times, unless they lie in front of confirmed depth of an earlier view
    (guessed pixels: of drawn depth).

    Args:
        inverse_depths: V of float32 [H, W]
        confirmed: V of float32 [H, W]. The same where depth was matched or propagated, infinite
            elsewhere.
        steps: V of float. Distance between depth candidates, the unit of the agreement tolerance.
    """
    keep = [np.ones(values.shape, bool) for values in inverse_depths]
    if len(keep) == 2:
        return keep
    for i, depth in enumerate(inverse_depths):
        guessed = ~np.isfinite(confirmed[i])
        keep[i] &= not guessed.all()
        relatives = [Relative.between(graph.cameras[i], camera) for camera in graph.cameras]
        for j in range(len(keep)):
            if j != i:
                refuted = cross_check(depth, confirmed[j], relatives[j], steps[i]) == IN_FRONT
                keep[i] &= ~(refuted & (guessed | (1 < i > j)))
        if i < 2:
            continue
        copies = np.zeros(depth.shape, np.uint8)
        for j in range(i):
            drawn = np.where(keep[j], inverse_depths[j], np.float32(np.inf))
            verdict = cross_check(depth, drawn, relatives[j], steps[i])
            keep[i] &= ~(guessed & (verdict == IN_FRONT))
            copies += verdict == AGREES
        keep[i] &= copies < MAX_COPIES
    return keep


def blend(
    images: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    steps: Sequence[float],
    links: Sequence[Sequence[Link]],
) -> list[np.ndarray]:
    """Blend the colours of every view with those of linked views that show the same surface.

    The weight of a view falls off within :data:`FEATHER_WIDTH` of its border and is zero where its
    depth disagrees. The nearest source has the same weight as the view itself; the weight of
    further sources falls with the square of their distance, because specular surfaces look
    different.

    Args:
        images: V of float32 [H, W, 3]
        inverse_depths: V of float32 [H, W]
        steps: V of float. Distance between depth candidates, the unit of the agreement tolerance.
        links: V sequences of Link

    Returns:
        V of float32 [H, W, 3]
    """
    mixed = []
    for i, sources in enumerate(links):
        H, W = inverse_depths[i].shape
        u, v = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        weight = _border_weight(u, v, W, H)
        total = images[i] * weight[..., None]
        baselines = np.array([np.linalg.norm(link.relative.t) for link in sources]).clip(1e-12)
        nearness = ((baselines.min() / baselines) ** 2).astype(np.float32)
        for link, share in zip(sources, nearness, strict=True):
            source_depth = inverse_depths[link.source]
            agrees = cross_check(inverse_depths[i], source_depth, link.relative, steps[i]) == AGREES
            y, x = np.nonzero(agrees)
            at, _ = link.relative.project(np.stack([x, y], 1) + 0.5, inverse_depths[i][y, x])
            source = images[link.source]
            u, v = at.T
            gain = share * _border_weight(u, v, source.shape[1], source.shape[0])
            weight[y, x] += gain
            total[y, x] = total[y, x] + gain[:, None] * _sample(source, at - 0.5)
        mixed.append(total / weight[..., None])
    return mixed


def _border_weight(u: np.ndarray, v: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the blending weight of a view at its pixels (u, v), float32."""
    inwards = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
    return np.minimum(inwards / FEATHER_WIDTH, 1).astype(np.float32)


def _sample(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Sample an image float32 [H, W, 3] bilinearly at ``at`` [N, 2], float64 [N, 3]."""
    left, top = np.floor(at).astype(np.int64).T
    p, q = (at - np.floor(at)).astype(np.float32).T[..., None]
    rows, columns, _ = image.shape
    i0, i1 = left.clip(0), (left + 1).clip(max=columns - 1)
    j0, j1 = top.clip(0), (top + 1).clip(max=rows - 1)
    upper, lower = ((1 - p.astype(np.float64)) * image[j, i0] + p * image[j, i1] for j in (j0, j1))
    return (1 - q.astype(np.float64)) * upper + q * lower
