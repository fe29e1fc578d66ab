"""3D-OVS-like: patches at the scale that tells the given classes apart best, pixel by pixel.

3D-OVS (arXiv 2305.14093) learns which of three patch sizes to believe at each point, together with
a field of segmentation features, from a closed list of classes and the boundaries of DINO features.
Here each pixel of a photograph believes the patch size whose best class leads the next one most;
its vector is lifted onto the Gaussians. Nothing is trained, and nothing aligns borders. The
list of classes is given, which no other method here has: a text competes with the rest of it.
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
class Ovs3dLike:
    """See the module.

    Attributes
    ----------
    parts : sequence of int
        Sides of the patches: the shorter side of the photograph over each of these. Those of
        3D-OVS by default.
    stride : float
        Between patches, in sides. 3D-OVS has a quarter; three quarters is a tenth of the work.

    Raises
    ------
    InputError
        If there is no part, one is below 1, or the stride is not in (0, 1].
    """

    parts: Sequence[int] = (5, 7, 10)
    stride: float = 0.75

    def __post_init__(self) -> None:
        if not len(self.parts) or min(self.parts) < 1:
            raise InputError(
                f"3d-ovs-like parts: found {list(self.parts)}, expected numbers of at least 1"
            )
        if not 0 < self.stride <= 1:
            raise InputError(
                f"3d-ovs-like stride: found {self.stride}, expected a number above 0, at most 1"
            )

    def __call__(self, inputs: Inputs) -> _Patches:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        size = inputs.sample.context[0].image.shape[:2]
        sides = [max(min(size) // part, 1) for part in self.parts]
        tilings = [Tiling(side, max(round(self.stride * side), 1)) for side in sides]
        levels = encode_pyramid(inputs, tilings)
        classes = tuple(text for text in inputs.classes if _usable(inputs, text))
        return _Patches(inputs, levels, choose_scales(inputs, levels, classes), classes)


@dataclass(frozen=True, eq=False)
class _Patches:
    inputs: Inputs
    levels: list[Level]
    chosen: np.ndarray
    classes: tuple[str, ...]

    def render(self, camera: Camera) -> DenseView:
        gaussians = self.inputs.gaussians
        picture = draw_picture(gaussians, camera)
        small = reduced(camera, self.levels[0].width)
        vectors = np.empty((1, small.height, small.width, self.levels[0].width), np.float32)
        draw_vectors(gaussians, small, self._at, vectors[0])
        seen = picture.alpha >= VISIBLE
        reader = self.inputs.reader
        return DenseView(picture.rgb, picture.depth, reader, seen, vectors, self.classes)

    def _at(self, pixels: np.ndarray, start: int, stop: int) -> np.ndarray:
        found = np.empty((len(pixels), stop - start), np.float32)
        chosen = self.chosen[pixels]
        for number, level in enumerate(self.levels):
            mine = chosen == number
            found[mine] = level.at(pixels[mine], start, stop)
        return found


def choose_scales(inputs: Inputs, levels: Sequence[Level], classes: Sequence[str]) -> np.ndarray:
    """The scale that each context pixel believes, int8 [V * H * W].

    That at which the best of the classes, or of the encoder's canonical phrases where there are
    fewer than two, leads the next one most, by the tiles' scores between which the pixel lies; of
    equal ones the first. With a single phrase it is the scale where that fits best.
    """
    texts = inputs.reader.vectors(classes if len(classes) > 1 else inputs.encoder.canonical)
    pixels = np.arange(inputs.label_maps.labels.size)
    leads = []
    for level in levels:
        ranked = np.sort(level.against(texts).at(pixels, 0, len(texts)), axis=1)
        leads.append(ranked[:, -1] - (ranked[:, -2] if len(texts) > 1 else 0))
    return np.stack(leads).argmax(0).astype(np.int8)


def _usable(inputs: Inputs, text: str) -> bool:
    try:
        inputs.reader.vectors([text])
    except InputError:
        return False
    return True
