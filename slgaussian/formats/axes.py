"""The half turn between x right, y down, z forward and x right, y up, z backward (glTF, SPZ)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slgaussian.gaussians import Gaussians

AXIS_SIGNS = np.array([1, -1, -1], np.float32)
"""Signs of positions between the two; the half turn is its own inverse."""

QUAT_SIGNS = np.array([1, 1, -1, -1], np.float32)
"""Signs of rotations wxyz under :data:`AXIS_SIGNS`."""

SH_SIGNS = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)
"""Signs of harmonics 0 to 15 under :data:`AXIS_SIGNS`; degree 1 is ordered y, z, x, and so on."""


def turn_axes(gaussians: Gaussians) -> Gaussians:
    """Return Gaussians in the other of the two axes: means, rotations, harmonics and origin."""
    arrays = gaussians.to_arrays()
    turned = gaussians.with_arrays(
        means=arrays["means"] * AXIS_SIGNS,
        quats=arrays["quats"] * QUAT_SIGNS,
        sh=arrays["sh"] * SH_SIGNS[: arrays["sh"].shape[1], None],
    )
    return replace(turned, origin=gaussians.origin * AXIS_SIGNS.astype(np.float64))
