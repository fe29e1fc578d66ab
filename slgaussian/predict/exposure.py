"""Exposure compensation, so that Gaussians of several views have one colour on a surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.predict.view_graph import ViewGraph

MIN_SAMPLES = 200
"""Smallest number of shared pixels on which two exposures are compared."""

MAX_SAMPLES = 20_000
"""Largest number of pixels per view that are compared, evenly spread."""

MIN_VALUE, MAX_VALUE = 8, 245
"""Range of pixel values that are compared: darker ones are noise, brighter ones clipped."""

MAX_GAIN = 2.0
"""Limit of the gain; larger estimates are errors."""

HUBER_THRESHOLD = 0.03
"""Huber threshold on log exposure: the usual variation of a camera. The influence of a view farther
from its neighbourhood stays constant. One photograph of five with 0.7 times the light then costs
0.2 dB in novel views, and 1.3 dB with a plain mean."""

ITERATIONS = 20
"""Iterations of reweighting; the last changes exposures by less than a thousandth."""


def colour_gains(
    images: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    answered: Sequence[np.ndarray],
    graph: ViewGraph,
) -> np.ndarray:
    """Estimate gains of the RGB values of each view that equalise exposure, float64 [V, 3].

    Log exposures are fitted by least squares to the median ratios over the answered pixels of a
    view and their projections in a linked one. Each view is brought to the mean exposure of its
    neighbourhood (:meth:`slgaussian.predict.view_graph.ViewGraph.closeness`), so that novel views
    along a walk look like the photographs near them. The mean is robust (:data:`HUBER_THRESHOLD`).

    Args:
        images: V of uint8 [H, W, 3]
        inverse_depths: V of float32 [H, W]
        answered: V of bool [H, W]
    """
    rows, ratios = [], []
    for i, link in ((i, link) for i, sources in enumerate(graph.links) for link in sources):
        j = link.source
        y, x = np.nonzero(answered[i])
        spacing = max(1, len(y) // MAX_SAMPLES)
        y, x = y[::spacing], x[::spacing]
        values = images[i][y, x]
        positions, ratio = link.relative.project(np.stack([x, y], 1) + 0.5, inverse_depths[i][y, x])
        H, W = answered[j].shape
        inside = (ratio > 0) & (positions >= 0).all(1) & (positions < (W, H)).all(1)
        column, row = positions[inside].astype(np.int64).T
        pair = np.stack([values[inside], images[j][row, column]], 1)
        fair = (pair.min((1, 2)) >= MIN_VALUE) & (pair.max((1, 2)) <= MAX_VALUE)
        if fair.sum() >= MIN_SAMPLES:
            logs = np.log(pair[fair].astype(np.float64))
            sign = np.zeros(len(images))
            sign[i], sign[j] = 1, -1
            rows.append(sign)
            ratios.append(np.median(logs[:, 1] - logs[:, 0], 0))
    if not rows:
        return np.ones((len(images), 3))
    # The minimum-norm solution: views without ratios keep gain 1.
    darker = np.linalg.lstsq(np.array(rows), np.array(ratios), rcond=None)[0]
    weights = graph.closeness()
    mean = weights @ darker
    for _ in range(ITERATIONS):  # Huber 1964
        residuals = np.abs(darker - mean[:, None])
        influence = weights[..., None] * HUBER_THRESHOLD / np.maximum(residuals, HUBER_THRESHOLD)
        mean = (influence * darker).sum(1) / influence.sum(1)
    return np.exp(darker - mean).clip(1 / MAX_GAIN, MAX_GAIN)
