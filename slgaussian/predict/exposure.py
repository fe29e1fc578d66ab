"""One exposure for all context views, so that their Gaussians do not make patches on a surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.predict.view_graph import ViewGraph

MIN_SAMPLES = 200
"""Fewest shared pixels that two exposures are compared on."""

MAX_SAMPLES = 20_000
"""If more pixels than this are answered, evenly spread ones are taken."""

DARK, BRIGHT = 8, 245
"""Values outside are noise or clipped and say nothing about exposure."""

MAX_GAIN = 2.0
"""Larger gains are taken for a mistake and cut."""

USUAL = 0.03
"""Difference of two logarithms of exposure up to which it is the camera's usual wavering. A view
farther off its neighbourhood has no more say in it than one at this distance: one photograph of
five with 0.7 times the light costs 0.2 dB in novel views then, and 1.3 dB if it counts in full."""

ROUNDS = 20
"""Of reweighting; the last moves exposures by less than a thousandth."""


def color_gains(
    images: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    answered: Sequence[np.ndarray],
    graph: ViewGraph,
) -> np.ndarray:
    """Factors float64 [V, 3] on the RGB values of each view that make neighbours agree.

    For every linked pair the median ratio of values is taken over the answered pixels of the first
    view and the pixels they land on in the second; exposures meet these ratios in least squares of
    their logarithms. Each view is brought to the mean exposure of its neighbourhood
    (:meth:`slgaussian.predict.view_graph.ViewGraph.closeness`), two views to the mean of both:
    along a walk from the dark into the light, views asked for look as the photographs there do. One
    among several that is far off the others has little say (:data:`USUAL`), so it comes to look as
    they.

    Parameters
    ----------
    images : V of uint8 [H, W, 3]
    inverse_depths : V of float32 [H, W]
    answered : V of bool [H, W]
    graph : ViewGraph
    """
    rows, ratios = [], []
    for i, link in ((i, link) for i, sources in enumerate(graph.links) for link in sources):
        j = link.source
        y, x = np.nonzero(answered[i])
        spacing = max(1, len(y) // MAX_SAMPLES)
        y, x = y[::spacing], x[::spacing]
        here = images[i][y, x]
        where, ratio = link.relative.project(np.stack([x, y], 1) + 0.5, inverse_depths[i][y, x])
        H, W = answered[j].shape
        inside = (ratio > 0) & (where >= 0).all(1) & (where < (W, H)).all(1)
        column, row = where[inside].astype(np.int64).T
        pair = np.stack([here[inside], images[j][row, column]], 1)
        fair = (pair.min((1, 2)) >= DARK) & (pair.max((1, 2)) <= BRIGHT)
        if fair.sum() >= MIN_SAMPLES:
            logs = np.log(pair[fair].astype(np.float64))
            sign = np.zeros(len(images))
            sign[i], sign[j] = 1, -1
            rows.append(sign)
            ratios.append(np.median(logs[:, 1] - logs[:, 0], 0))
    if not rows:
        return np.ones((len(images), 3))
    # The least-norm solution: views that nothing is known about keep gain 1.
    darker = np.linalg.lstsq(np.array(rows), np.array(ratios), rcond=None)[0]
    around = _usual(darker, graph.closeness())
    return np.exp(darker - around).clip(1 / MAX_GAIN, MAX_GAIN)


def _usual(darker: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Around each view the weighted mean [V, 3] of what is not far off it (Huber 1964)."""
    mean = weights @ darker
    for _ in range(ROUNDS):
        off = np.abs(darker - mean[:, None])
        say = weights[..., None] * USUAL / np.maximum(off, USUAL)
        mean = (say * darker).sum(1) / say.sum(1)
    return mean
