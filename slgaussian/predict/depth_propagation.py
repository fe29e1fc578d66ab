"""Depth that a view could not find, lent by others that look at the same surface.

A blank wall in one photograph may lie beside an edge in another, or another pair may see it from a
better angle: what its neighbours answered is believed before planes are guessed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.predict.depth_completion import without_speckles
from slgaussian.predict.view_graph import Link

SPECKLE = 1 / 1200
"""Answered patches of at most this share of the image are taken for accidents and filled instead.
"""

ALIKE = 0.12
"""Difference of smoothed colours, the greatest of RGB in [0, 1], up to which a point that another
view answered is taken for what this view shows there, and not for something hidden behind it."""

SMOOTH = 5
"""Side of the box that colours are smoothed over, pixels."""

AROUND = 5
"""Lent neighbours, of eight, from which on a pixel between them is lent too: points do not land on
every pixel."""


@dataclass(frozen=True, eq=False)
class Swept:
    """One view after the sweep: candidates, raw depth, and where another view confirms it.

    Attributes
    ----------
    steps : float64 [D]
        Candidate inverse depths, ascending.
    inverse_depth : float32 [H, W]
        1 / z in scene units, between the first and last candidate.
    answered : bool [H, W]
        Where matching gave the depth and another view agrees.
    given : bool [H, W] or None
        Where depth of other origin stays as it is, whether another view agrees or not.
    """

    steps: np.ndarray
    inverse_depth: np.ndarray
    answered: np.ndarray
    given: np.ndarray | None = None

    @property
    def step(self) -> float:
        """Distance between neighbouring candidates."""
        return float(self.steps[1] - self.steps[0])

    @property
    def known(self) -> np.ndarray:
        """Inverse depth where it is answered, infinite elsewhere."""
        return np.where(self.answered, self.inverse_depth, np.float32(np.inf))


def lend(
    swept: Sequence[Swept], images: Sequence[np.ndarray], links: Sequence[Sequence[Link]]
) -> list[Swept]:
    """The views with depths that their sources answered where they have none.

    Parameters
    ----------
    swept : V Swept
    images : V of float32 [H, W, 3]
        RGB in [0, 1], brought to one exposure.
    links : V sequences of Link
    """
    smooth = [cv2.blur(image, (SMOOTH, SMOOTH)) for image in images]
    result = []
    for i, mine in enumerate(swept):
        landed = np.zeros(mine.answered.shape, np.float32)
        for link in links[i]:
            back = link.relative.reversed()
            other = swept[link.source]
            _land(
                other.inverse_depth, other.answered, smooth[link.source], smooth[i],
                back.infinity, back.epipole, ALIKE, landed,
            )  # fmt: skip
        landed = np.where(landed >= mine.steps[0], landed, 0)
        around = cv2.boxFilter((landed > 0).astype(np.float32), -1, (3, 3), normalize=False)
        between = (landed == 0) & (around >= AROUND - 0.5)
        landed = np.where(between, cv2.dilate(landed, np.ones((3, 3))), landed)
        if mine.given is not None:
            landed[mine.given] = 0
        inverse_depth = np.where(mine.answered | (landed == 0), mine.inverse_depth, landed)
        index = ((inverse_depth - mine.steps[0]) / mine.step).astype(np.float32)
        known = mine.answered | (landed > 0)
        answered = without_speckles(index, known, int(SPECKLE * known.size))
        result.append(replace(mine, inverse_depth=inverse_depth, answered=answered))
    return result


@kernel
def _land(inverse_depth, answered, image, target, A, e, alike, landed):
    """Write the greatest inverse depth of the answered pixels that land in each of the target."""
    H, W = inverse_depth.shape
    for y in range(H):
        for x in range(W):
            if not answered[y, x]:
                continue
            u, v, w = x + 0.5, y + 0.5, float(inverse_depth[y, x])
            z = A[2, 0] * u + A[2, 1] * v + A[2, 2] + w * e[2]
            if z <= 1e-9:
                continue
            i = math.floor((A[1, 0] * u + A[1, 1] * v + A[1, 2] + w * e[1]) / z)
            j = math.floor((A[0, 0] * u + A[0, 1] * v + A[0, 2] + w * e[0]) / z)
            if not (0 <= i < H and 0 <= j < W):
                continue
            off = 0.0
            for c in range(3):
                off = max(off, abs(image[y, x, c] - target[i, j, c]))
            if off < alike:
                landed[i, j] = max(landed[i, j], np.float32(w / z))
