"""Baselines with encoded image crops and without masks: LERF-like and 3D-OVS-like.

Square crops of the photographs at several scales are encoded on a grid; each Gaussian gets the
vectors of its source pixel. No field is trained and nothing is regularised.

LERF (arXiv 2303.09553) trains a field of language features over position and scale on such a
pyramid, in thousands of steps over many photographs, with DINO features as regularisation. 3D-OVS
(arXiv 2305.14093) learns which of three patch sizes to select at each point, together with a field
of segmentation features, from a closed list of classes and the boundaries of DINO features; here
each pixel selects the size with the largest margin between its best and second-best class. Unlike
the other methods it gets the list of classes, with which a text competes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slgaussian.benchmark.answering import understands
from slgaussian.benchmark.baselines.dense import DenseView, draw_picture, draw_vectors, reduced
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE

BATCH = 512
"""Tiles encoded together: their masks are a byte a pixel of the photograph each, 120 MB at
416 x 576. Some encoders look at the whole photograph once for all of them."""


@dataclass(frozen=True)
class LerfLike:
    """Vectors at several scales; each text uses its best scale for the whole image.

    Attributes:
        scales: sequence of float. Sides of the crops over the height of the photograph, in (0, 1].
            LERF has seven, evenly from 0.05 to 0.5, with strides from a full
            side at 0.05 to half a side from 0.15 on; here strides are the same, and there are three
            scales to save time.
    """

    scales: Sequence[float] = (0.1, 0.25, 0.5)

    def __call__(self, inputs: Inputs) -> LiftedVectors:
        """Encode the pyramid of a scene."""
        height = inputs.sample.context[0].camera.height
        sides = [max(round(scale * height), 1) for scale in self.scales]
        strides = [float(np.interp(scale, (0.05, 0.15), (1.0, 0.5))) for scale in self.scales]
        levels = encode_pyramid(inputs, sides, strides)
        return LiftedVectors(inputs, [level.at for level in levels], levels[0].values.shape[3])


@dataclass(frozen=True)
class Ovs3dLike:
    """Patches at the scale that best separates the given classes, per pixel.

    Attributes:
        parts: sequence of int. Sides of the patches: the shorter side of the photograph over each
            of these, at least 1. Those of 3D-OVS by default.
        stride: Distance of patches in sides, in (0, 1]. 3D-OVS uses 0.25; 0.75 takes a tenth of the
            time.
    """

    parts: Sequence[int] = (5, 7, 10)
    stride: float = 0.75

    def __call__(self, inputs: Inputs) -> LiftedVectors:
        """Encode the patches of a scene, and select the patch size of each pixel."""
        shorter = min(inputs.sample.context[0].image.shape[:2])
        sides = [max(shorter // part, 1) for part in self.parts]
        levels = encode_pyramid(inputs, sides, [self.stride] * len(sides))
        classes = tuple(text for text in inputs.classes if understands(inputs.reader, text))
        chosen = choose_scales(inputs, levels, classes)

        def at(pixels: np.ndarray, start: int, stop: int) -> np.ndarray:
            vectors = np.empty((len(pixels), stop - start), np.float32)
            believed = chosen[pixels]
            for number, level in enumerate(levels):
                mine = believed == number
                vectors[mine] = level.at(pixels[mine], start, stop)
            return vectors

        return LiftedVectors(inputs, [at], levels[0].values.shape[3], classes)


@dataclass(frozen=True, eq=False)
class LiftedVectors:
    """Gaussians with the vectors of their source pixels.

    Attributes:
        scales: sequence of callable. See :func:`slgaussian.benchmark.baselines.dense.draw_vectors`;
            one per scale.
        width: Dimension of a vector.
        classes: tuple of str. Closed list of texts, empty without one.
    """

    inputs: Inputs
    scales: Sequence[Callable[[np.ndarray, int, int], np.ndarray]]
    width: int
    classes: tuple[str, ...] = ()

    def render(self, camera: Camera) -> DenseView:
        """Render colours and vectors for ``camera``."""
        gaussians, reader = self.inputs.gaussians, self.inputs.reader
        picture = draw_picture(gaussians, camera)
        small = reduced(camera, self.width * len(self.scales))
        vectors = draw_vectors(gaussians, small, self.scales, self.width)
        visible = picture.alpha >= VISIBLE
        return DenseView(picture.rgb, picture.depth, reader, visible, vectors, self.classes)


def choose_scales(inputs: Inputs, levels: Sequence[Level], classes: Sequence[str]) -> np.ndarray:
    """Select the scale of each context pixel, int8 [V * H * W].

    It is the scale with the largest margin between best and second-best class, or canonical phrase
    of the encoder if there are fewer than two classes, of the scores interpolated between tiles;
    ties go to the first. With a single phrase it is the scale of its highest score.
    """
    texts = inputs.reader.vectors(classes if len(classes) > 1 else inputs.encoder.canonical)
    pixels = np.arange(inputs.label_maps.labels.size)
    leads = []
    for level in levels:
        cosines = replace(level, values=np.einsum("vrcd,td->vrct", level.values, texts))
        ranked = np.sort(cosines.at(pixels, 0, len(texts)), axis=1)
        leads.append(ranked[:, -1] - (ranked[:, -2] if len(texts) > 1 else 0))
    return np.stack(leads).argmax(0).astype(np.int8)


@dataclass(frozen=True, eq=False)
class Level:
    """Values of the tiles of one scale.

    Attributes:
        values: float32 [V, rows, columns, C]. Unit vectors of the tiles of the context views, or
            values computed from them.
        centres: tuple of float64 [rows], [columns]. Centres of the tiles, pixels.
        size: tuple of int. (H, W) of the photographs.
    """

    values: np.ndarray
    centres: tuple[np.ndarray, np.ndarray]
    size: tuple[int, int]

    def at(self, pixels: np.ndarray, start: int, stop: int) -> np.ndarray:
        """Return components ``start`` to ``stop`` at context pixels, float32 [n, stop - start].

        ``pixels`` int64 [n] are flat indices of [V, H, W]. Bilinear between centres, and constant
        beyond the outermost.
        """
        view, *place = np.unravel_index(pixels, (len(self.values), *self.size))
        values, corners = self.values[..., start:stop], []
        for at, centres in zip(place, self.centres, strict=True):
            # The tile centre before each pixel, the one after it, and the interpolation weight.
            tile = np.interp(at + 0.5, centres, np.arange(len(centres)))
            before = np.minimum(tile.astype(np.int64), max(len(centres) - 2, 0))
            after = np.minimum(before + 1, len(centres) - 1)
            corners.append((before, after, (tile - before).astype(np.float32)[:, None]))
        (top, bottom, down), (left, right, across) = corners
        upper = values[view, top, left] * (1 - across) + values[view, top, right] * across
        lower = values[view, bottom, left] * (1 - across) + values[view, bottom, right] * across
        return upper * (1 - down) + lower * down


def encode_pyramid(inputs: Inputs, sides: Sequence[int], strides: Sequence[float]) -> list[Level]:
    """Encode square tiles of every context view at every scale.

    Tiles have ``sides`` pixels, and their distance is at most ``strides`` sides.

    Raises:
        InputError: If the encoder does not encode images.
    """
    size = inputs.label_maps.labels.shape[1:]
    starts = [
        [tile_starts(length, side, max(round(stride * side), 1)) for length in size]
        for side, stride in zip(sides, strides, strict=True)
    ]
    squares = [
        (y, x, side)
        for side, (rows, columns) in zip(sides, starts, strict=True)
        for y in rows
        for x in columns
    ]
    batches = [squares[k : k + BATCH] for k in range(0, len(squares), BATCH)]
    vectors = np.stack(
        [
            np.concatenate(
                [
                    inputs.encoder.encode_regions(view.image, _masks(batch, size), around)
                    for batch in batches
                ]
            )
            for view, around in zip(
                inputs.sample.context, inputs.geometry.surroundings, strict=True
            )
        ]
    )
    counts = [len(rows) * len(columns) for rows, columns in starts]
    levels = []
    for side, firsts, part in zip(
        sides, starts, np.split(vectors, np.cumsum(counts)[:-1], axis=1), strict=True
    ):
        centres = tuple(
            (first + np.minimum(first + side, length)) / 2
            for first, length in zip(firsts, size, strict=True)
        )
        shape = len(part), *map(len, firsts), part.shape[2]
        levels.append(Level(part.reshape(shape), centres, size))
    return levels


def tile_starts(length: int, side: int, stride: int) -> np.ndarray:
    """Return the first pixels of evenly spaced tiles that cover an axis of ``length`` pixels."""
    room = max(length - side, 0)
    return np.rint(np.linspace(0, room, -(-room // stride) + 1)).astype(np.int64)


def _masks(squares: Sequence[tuple[int, int, int]], size: tuple[int, int]) -> np.ndarray:
    """Return masks bool [n, H, W] of squares (first row, first column, side)."""
    masks = np.zeros((len(squares), *size), bool)
    for mask, (y, x, side) in zip(masks, squares, strict=True):
        mask[y : y + side, x : x + side] = True
    return masks
