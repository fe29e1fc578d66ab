"""Choose keyframes that cover the content of many photographs or of a video."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import Camera

MIDDLE = 0.5
"""Fraction of a segment, about its middle, from which the keyframe is chosen, so that two keyframes
are at least half a segment apart."""


def choose_keyframes(
    blurs: Sequence[float], count: int, cameras: Sequence[Camera] | None = None
) -> list[int]:
    """Choose the keyframes; return their indices, ascending.

    The camera path is divided into ``count`` equal segments, and the sharpest frame in the middle
    of each is chosen. Path length is translation plus rotation, each as a fraction of its total, so
    a camera at rest adds nothing. Without cameras, frames are assumed to be evenly spaced. A
    segment without a frame gives no keyframe.

    Args:
        blurs: sequence of N float. :func:`slgaussian.datasets.sharpness.blur` of every frame, in
            temporal order.
        count: Two or more.
        cameras: sequence of N Camera, optional

    Raises:
        InputError: If ``count`` is below two.
    """
    if count < 2:
        raise InputError(f"keyframes: found {count}, expected two or more")
    if len(blurs) <= count:
        return list(range(len(blurs)))
    part = _way(len(blurs), cameras) * count
    number = np.minimum(part.astype(int), count - 1)
    off = np.abs(part - number - 0.5)
    chosen = []
    for k in range(count):
        inside = np.flatnonzero(number == k)
        middle = inside[off[inside] <= MIDDLE / 2]
        if len(inside):
            among = middle if len(middle) else inside
            chosen.append(int(among[np.argmin(np.asarray(blurs)[among])]))
    return chosen


def _way(frames: int, cameras: Sequence[Camera] | None) -> np.ndarray:
    """Return the position of each frame along the path, float64 [N] from 0 to 1."""
    even = np.linspace(0, 1, frames)
    if cameras is None:
        return even
    centers = np.array([camera.center for camera in cameras])
    axes = np.array([camera.c2w[:3, 2] for camera in cameras])
    moved = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    turned = np.arccos((axes[1:] * axes[:-1]).sum(1).clip(-1, 1))
    shares = [steps / steps.sum() for steps in (moved, turned) if steps.sum() > 0]
    if not shares:
        return even
    return np.concatenate([[0], np.cumsum(np.mean(shares, axis=0))])
