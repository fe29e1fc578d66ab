"""Square crops of the photographs at several scales, encoded on a grid: vectors without masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.geometry.room import Surroundings
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.language import Encoder

BATCH = 512
"""Tiles encoded together: their masks are a byte a pixel of the photograph each, 120 MB at
416 x 576. Some encoders look at the whole photograph once for all of them."""


@dataclass(frozen=True)
class Tiling:
    """One scale: tiles of ``side`` pixels, a new one every ``stride`` pixels at most."""

    side: int
    stride: int

    def starts(self, length: int) -> np.ndarray:
        """First pixels of the tiles along an axis of ``length`` pixels, evenly, to both ends."""
        room = max(length - self.side, 0)
        count = -(-room // self.stride) + 1
        return np.rint(np.linspace(0, room, count)).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Level:
    """Something that the tiles of one scale have.

    Attributes
    ----------
    values : float32 [V, rows, columns, k]
        Of the context views, which are of one size: the tiles' unit vectors, or something made of
        them.
    centres : tuple of float64 [rows], [columns]
        Where the tiles' centres lie, in pixels.
    size : tuple of int
        (H, W) of the photographs.
    """

    values: np.ndarray
    centres: tuple[np.ndarray, np.ndarray]
    size: tuple[int, int]

    @property
    def width(self) -> int:
        """Numbers a tile, k."""
        return self.values.shape[3]

    def at(self, pixels: np.ndarray, start: int, stop: int) -> np.ndarray:
        """The numbers ``start`` to ``stop`` at context pixels, float32 [n, stop - start].

        ``pixels`` int64 [n] are flat indices of [V, H, W]. Bilinear between centres, and constant
        beyond the outermost.
        """
        found = np.empty((len(pixels), stop - start), np.float32)
        down, across = (
            _between(centres, length)
            for centres, length in zip(self.centres, self.size, strict=True)
        )
        values = np.ascontiguousarray(self.values[..., start:stop])
        share(_sample, len(pixels), values, *down, *across, pixels, found)
        return found

    def against(self, texts: np.ndarray) -> Level:
        """The cosines of the tiles with unit vectors float [Q, C], in place of their vectors."""
        return replace(self, values=np.einsum("vrcd,td->vrct", self.values, texts))


def encode_pyramid(inputs: Inputs, tilings: Sequence[Tiling]) -> list[Level]:
    """Encode the tiles of every context view at every scale.

    Raises
    ------
    InputError
        If the encoder does not look at images.
    """
    size = inputs.label_maps.labels.shape[1:]
    places = [[tiling.starts(length) for length in size] for tiling in tilings]
    tiles = [
        (y, x, tiling.side)
        for tiling, (rows, columns) in zip(tilings, places, strict=True)
        for y in rows
        for x in columns
    ]
    context = inputs.sample.context
    vectors = np.stack(
        [
            _encode(inputs.encoder, tiles, view.image, around)
            for view, around in zip(context, inputs.geometry.surroundings, strict=True)
        ]
    )
    counts = [len(rows) * len(columns) for rows, columns in places]
    parts = np.split(vectors, np.cumsum(counts)[:-1], axis=1)
    levels = []
    for tiling, starts, part in zip(tilings, places, parts, strict=True):
        shape = len(part), *map(len, starts), part.shape[2]
        centres = tuple(
            (first + np.minimum(first + tiling.side, length)) / 2
            for first, length in zip(starts, size, strict=True)
        )
        levels.append(Level(part.reshape(shape), centres, size))
    return levels


def _encode(
    encoder: Encoder,
    tiles: Sequence[tuple[int, int, int]],
    image: np.ndarray,
    around: Surroundings,
) -> np.ndarray:
    """Unit vectors [n, C] of tiles given by first row, first column and side."""
    found = []
    for start in range(0, len(tiles), BATCH):
        batch = tiles[start : start + BATCH]
        masks = np.zeros((len(batch), *image.shape[:2]), bool)
        for mask, (y, x, side) in zip(masks, batch, strict=True):
            mask[y : y + side, x : x + side] = True
        found.append(encoder.encode_regions(image, masks, around))
    return np.concatenate(found)


def _between(centres: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel of an axis the centre before it, and how far it is on the way to the next."""
    place = np.interp(np.arange(length) + 0.5, centres, np.arange(len(centres)))
    low = np.minimum(place.astype(np.int64), max(len(centres) - 2, 0))
    return low, (place - low).astype(np.float32)


@kernel
def _sample(counter, values, low_y, share_y, low_x, share_x, pixels, found):
    height, width = len(low_y), len(low_x)
    rows, columns = values.shape[1], values.shape[2]
    one = np.float32(1)
    n = take(counter)
    while n < len(pixels):
        line, x = divmod(pixels[n], width)
        view, y = divmod(line, height)
        grid, down, right = values[view], share_y[y], share_x[x]
        top, left = low_y[y], low_x[x]
        bottom, after = min(top + 1, rows - 1), min(left + 1, columns - 1)
        a, b = (one - down) * (one - right), (one - down) * right
        c, d = down * (one - right), down * right
        for k in range(values.shape[3]):
            upper = a * grid[top, left, k] + b * grid[top, after, k]
            found[n, k] = upper + (c * grid[bottom, left, k] + d * grid[bottom, after, k])
        n = take(counter)
