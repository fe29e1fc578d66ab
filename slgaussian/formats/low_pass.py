"""Gaussians as wide as they are drawn, for viewers that widen them less than ``render``.

A rasteriser adds a low-pass filter to every projected covariance (``low_pass`` of
:class:`slgaussian.rasterize.render_settings.Settings`, 0.3 px^2 here and in Kerbl et al. 2023).
Gaussians of pixels are smaller than that, and viewers differ in it: PlayCanvas adds 0.075 px^2,
Spark takes from the opacity what it adds to the width. Such a scene would be dark and full of gaps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.gaussians import Gaussians
from slgaussian.rasterize.render_settings import Settings
from slgaussian.scene import Camera


def include_low_pass(gaussians: Gaussians, cameras: Sequence[Camera]) -> Gaussians:
    """Return Gaussians with the filter of the view from which each was predicted in its scales.

    A filter of ``low_pass`` px^2 is a variance of ``low_pass (z / f)^2`` at depth z and focal
    length f. Gaussians of no pixel remain as they are: they were trained with a filter.

    Args:
        cameras: sequence of V Camera. The context cameras, in order, all of one size.
    """
    if not gaussians.pixelwise:
        return gaussians
    arrays = gaussians.to_arrays()
    views = arrays["source"] // (cameras[0].width * cameras[0].height)
    variances = arrays["scales"].astype(np.float64) ** 2
    for number, camera in enumerate(cameras):
        mine = views == number
        points = arrays["means"][mine].astype(np.float64)
        z = gaussians.localize(camera).project(points)[1]
        variances[mine] += Settings().low_pass * (z / camera.K[0, 0])[:, None] ** 2
    return gaussians.with_arrays(scales=np.sqrt(variances).astype(np.float32))
