"""Propagation of matched depth from source views into pixels that a view could not match.

A blank wall in one photograph may lie beside an edge in another, or another pair may see it from a
better angle. So the depth of neighbouring views is used before planes are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from slgaussian.predict.depth_completion import remove_speckles
from slgaussian.predict.view_graph import Link

MAX_SPECKLE_SHARE = 1 / 1200
"""Connected answered patches of at most this share of the image are removed as false matches."""

COLOUR_TOLERANCE = 0.12
"""Largest difference of smoothed colours, over RGB in [0, 1], at which a point of another view is
accepted as the surface that this view shows, and not as a surface occluded by it."""

COLOUR_FILTER_SIDE = 5
"""Side of the box filter of colours, pixels."""

MIN_NEIGHBOURS = 5
"""Number of propagated neighbours, of eight, from which a pixel between them is filled as well:
points do not land on every pixel."""


@dataclass(frozen=True, eq=False)
class SweptView:
    """A view after the plane sweep: candidates, raw depth, and a mask of confirmed pixels.

    Attributes:
        steps: float64 [D]. Candidate inverse depths, ascending.
        inverse_depth: float32 [H, W]. 1 / z in scene units, between the first and last candidate.
        answered: bool [H, W]. Pixels with matched depth that another view confirms.
        fixed: bool [H, W] or None. Pixels with depth from files, which is not changed even if no
            view confirms it.
    """

    steps: np.ndarray
    inverse_depth: np.ndarray
    answered: np.ndarray
    fixed: np.ndarray | None = None

    @property
    def step(self) -> float:
        """Distance between neighbouring candidates."""
        return float(self.steps[1] - self.steps[0])

    @property
    def valid(self) -> np.ndarray:
        """Mask of answered and fixed pixels, bool [H, W]; all others are guessed."""
        return self.answered if self.fixed is None else self.answered | self.fixed

    @property
    def confirmed(self) -> np.ndarray:
        """Inverse depth of answered pixels, infinite elsewhere; float32 [H, W]."""
        return np.where(self.answered, self.inverse_depth, np.float32(np.inf))


def propagate_depth(
    swept: Sequence[SweptView], images: Sequence[np.ndarray], links: Sequence[Sequence[Link]]
) -> list[SweptView]:
    """Fill unanswered pixels of every view with depth that its source views answered.

    Args:
        swept: V Swept
        images: V of float32 [H, W, 3]. RGB in [0, 1], with compensated exposure.
        links: V sequences of Link
    """
    smooth = [cv2.blur(image, (COLOUR_FILTER_SIDE, COLOUR_FILTER_SIDE)) for image in images]
    result = []
    for i, view in enumerate(swept):
        landed = np.zeros(view.answered.shape, np.float32)
        for link in links[i]:
            source = swept[link.source]
            y, x = np.nonzero(source.answered)
            w = source.inverse_depth[y, x].astype(np.float64)
            at, ratio = link.relative.reverse().project(np.stack([x, y], 1) + 0.5, w)
            inside = (ratio > 1e-9) & (at >= 0).all(1) & (at < landed.shape[::-1]).all(1)
            column, row = at[inside].astype(np.int64).T
            difference = smooth[link.source][y[inside], x[inside]] - smooth[i][row, column]
            similar = np.abs(difference).max(1) < np.float64(COLOUR_TOLERANCE)
            lent = (w[inside] / ratio[inside]).astype(np.float32)
            np.maximum.at(landed, (row[similar], column[similar]), lent[similar])
        landed = np.where(landed >= view.steps[0], landed, 0)
        neighbours = cv2.boxFilter((landed > 0).astype(np.float32), -1, (3, 3), normalize=False)
        between = (landed == 0) & (neighbours >= MIN_NEIGHBOURS - 0.5)
        landed = np.where(between, cv2.dilate(landed, np.ones((3, 3))), landed)
        if view.fixed is not None:
            landed[view.fixed] = 0
        inverse_depth = np.where(view.answered | (landed == 0), view.inverse_depth, landed)
        index = ((inverse_depth - view.steps[0]) / view.step).astype(np.float32)
        answered_or_lent = view.answered | (landed > 0)
        answered = remove_speckles(
            index, answered_or_lent, int(MAX_SPECKLE_SHARE * answered_or_lent.size)
        )
        result.append(replace(view, inverse_depth=inverse_depth, answered=answered))
    return result
