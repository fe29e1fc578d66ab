"""What the views agree on: the colours of what several show, and who of them draws it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from slgaussian.cameras.relative import Relative
from slgaussian.kernels.jit import kernel
from slgaussian.predict.depth_completion import AGREES, IN_FRONT, cross_check
from slgaussian.predict.view_graph import Link, ViewGraph

COPIES = 2
"""Views that draw one surface, at most. On a forward-facing capture of eight views one is 0.3 dB
worse, and all eight are 1 dB worse."""

FEATHER = 16.0
"""Distance from the image border, pixels, over which a view gains its full say in a blend: where
its image ends there is no seam then."""


def needed(
    graph: ViewGraph,
    inverse_depths: Sequence[np.ndarray],
    known: Sequence[np.ndarray],
    steps: Sequence[float],
) -> list[np.ndarray]:
    """Which pixels of each view bring a surface that is not there yet: V of bool [H, W].

    Two views draw all they show. Of more, one of which nothing is known draws nothing, and no guess
    is drawn that lies where any view has matched something behind it. The first two draw the rest;
    then the views come one after the other, in the order given, and draw what is drawn less than
    :data:`COPIES` times and does not stand in front of what those before have matched (of a guess:
    of what they have drawn). So what is drawn mostly stays when a photograph is added.

    Parameters
    ----------
    graph : ViewGraph
    inverse_depths : V of float32 [H, W]
    known : V of float32 [H, W]
        The same where it was matched or lent, infinite elsewhere.
    steps : V of float
        Distance between candidates, which agreement is measured by.
    """
    keep = [np.ones(values.shape, bool) for values in inverse_depths]
    if len(keep) == 2:
        return keep
    for i, mine in enumerate(inverse_depths):
        guessed = ~np.isfinite(known[i])
        keep[i] &= not guessed.all()
        relatives = [Relative.between(graph.cameras[i], camera) for camera in graph.cameras]
        for j in range(len(keep)):
            if j != i:
                refuted = cross_check(mine, known[j], relatives[j], steps[i]) == IN_FRONT
                keep[i] &= ~(refuted & (guessed | (1 < i > j)))
        if i < 2:
            continue
        shown = np.zeros(mine.shape, np.uint8)
        for j in range(i):
            drawn = np.where(keep[j], inverse_depths[j], np.float32(np.inf))
            verdict = cross_check(mine, drawn, relatives[j], steps[i])
            keep[i] &= ~(guessed & (verdict == IN_FRONT))
            shown += verdict == AGREES
        keep[i] &= shown < COPIES
    return keep


def blend(
    images: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    steps: Sequence[float],
    links: Sequence[Sequence[Link]],
) -> list[np.ndarray]:
    """Colours of every view, mixed with those of the linked views that show the same surface.

    So a surface has one colour, whichever view's copy of it is in front. A view counts fully, less
    within :data:`FEATHER` of its border, and not at all where its depth does not agree. Of the
    others the nearest counts like the view itself, the rest by the square of their distance: a
    shining floor looks different from elsewhere.

    Parameters
    ----------
    images : V of float32 [H, W, 3]
    inverse_depths : V of float32 [H, W]
    steps : V of float
        Distance between candidates, which agreement is measured by.
    links : V sequences of Link

    Returns
    -------
    V of float32 [H, W, 3]
    """
    mixed = []
    for i, sources in enumerate(links):
        H, W = inverse_depths[i].shape
        u, v = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        weight = _say(u, v, W, H)
        total = images[i] * weight[..., None]
        apart = np.array([np.linalg.norm(link.relative.t) for link in sources]).clip(1e-12)
        nearness = ((apart.min() / apart) ** 2).astype(np.float32)
        for link, near in zip(sources, nearness, strict=True):
            other = inverse_depths[link.source]
            agrees = cross_check(inverse_depths[i], other, link.relative, steps[i]) == AGREES
            relative = link.relative
            _add(
                total, weight, agrees, inverse_depths[i], images[link.source],
                relative.infinity, relative.epipole, FEATHER, near,
            )  # fmt: skip
        mixed.append(total / weight[..., None])
    return mixed


def _say(u: np.ndarray, v: np.ndarray, width: int, height: int) -> np.ndarray:
    """Weight float32 of a view at its pixels (u, v)."""
    inwards = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
    return np.minimum(inwards / FEATHER, 1).astype(np.float32)


@kernel
def _add(total, weight, agrees, inverse_depth, image, A, e, feather, near):
    """Add what the other view shows, bilinear and by its weight, where it agrees."""
    H, W = inverse_depth.shape
    rows, columns, _ = image.shape
    for y in range(H):
        for x in range(W):
            if not agrees[y, x]:
                continue
            a, b, w = x + 0.5, y + 0.5, float(inverse_depth[y, x])
            z = A[2, 0] * a + A[2, 1] * b + A[2, 2] + w * e[2]
            u = (A[0, 0] * a + A[0, 1] * b + A[0, 2] + w * e[0]) / z
            v = (A[1, 0] * a + A[1, 1] * b + A[1, 2] + w * e[1]) / z
            say = min(min(u, columns - u), min(v, rows - v)) / feather
            say = near * np.float32(min(say, 1.0))
            left, top = math.floor(u - 0.5), math.floor(v - 0.5)
            p, q = np.float32(u - 0.5 - left), np.float32(v - 0.5 - top)
            i0, i1 = max(left, 0), min(left + 1, columns - 1)
            j0, j1 = max(top, 0), min(top + 1, rows - 1)
            weight[y, x] += say
            for c in range(3):
                upper = (1 - p) * image[j0, i0, c] + p * image[j0, i1, c]
                lower = (1 - p) * image[j1, i0, c] + p * image[j1, i1, c]
                total[y, x, c] += say * ((1 - q) * upper + q * lower)
