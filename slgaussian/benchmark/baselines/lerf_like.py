"""LERF-like: what crops of many sizes say, at every pixel and scale, lifted onto the Gaussians.

LERF (arXiv 2303.09553) trains a field of language features over position and scale against a
pyramid of crops, in thousands of steps over many photographs, with DINO features beside it. Here
the pyramid itself is lifted: each Gaussian has what its source pixel has, at each scale. No field
is trained and nothing is regularised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.benchmark.baselines.dense import DenseView
from slgaussian.benchmark.baselines.drawn import draw_picture, draw_vectors, reduced
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.baselines.pyramid import Level, Tiling, encode_pyramid
from slgaussian.errors import InputError
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE


@dataclass(frozen=True)
class LerfLike:
    """See the module.

    Attributes
    ----------
    scales : sequence of float
        Sides of the crops in heights of the photograph, in (0, 1]. LERF has seven, evenly from
        0.05 to 0.5, with strides from a whole side at 0.05 to half of one from 0.15 on; strides
        are the same here, scales are three, for time.

    Raises
    ------
    InputError
        If there is no scale, or one is out of range.
    """

    scales: Sequence[float] = (0.1, 0.25, 0.5)

    def __post_init__(self) -> None:
        if not len(self.scales) or not all(0 < scale <= 1 for scale in self.scales):
            raise InputError(
                f"lerf-like scales: found {list(self.scales)}, expected shares of the height above "
                "0, at most 1"
            )

    def __call__(self, inputs: Inputs) -> _Pyramid:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        height = inputs.sample.context[0].camera.height
        tilings = [_tiling(scale, height) for scale in self.scales]
        return _Pyramid(inputs, encode_pyramid(inputs, tilings))


@dataclass(frozen=True, eq=False)
class _Pyramid:
    inputs: Inputs
    levels: list[Level]

    def render(self, camera: Camera) -> DenseView:
        gaussians = self.inputs.gaussians
        picture = draw_picture(gaussians, camera)
        width = self.levels[0].width
        small = reduced(camera, width * len(self.levels))
        size = small.height, small.width
        vectors = np.empty((len(self.levels), *size, width), np.float32)
        for level, drawn in zip(self.levels, vectors, strict=True):
            draw_vectors(gaussians, small, level.at, drawn)
        seen = picture.alpha >= VISIBLE
        return DenseView(picture.rgb, picture.depth, self.inputs.reader, seen, vectors)


def _tiling(scale: float, height: int) -> Tiling:
    fraction = float(np.interp(scale, (0.05, 0.15), (1.0, 0.5)))
    side = max(round(scale * height), 1)
    return Tiling(side, max(round(fraction * side), 1))
