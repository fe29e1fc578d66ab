"""ID codes: a low-dimensional vector for every object.

Section 3.2 of the paper: N points of a grid of ceil(cbrt N)^3 points in [0, 1]^3 are chosen at
random; a rendered vector is decoded to the object whose code is nearest in L1
(:mod:`slgaussian.language.nearest`). :mod:`slgaussian.language.separated` optimises the choice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language.configs import GridConfig, SeparatedConfig
from slgaussian.language.separated import misread, neighbours, place

if TYPE_CHECKING:
    from slgaussian.labels import LabelMaps


class Grid(GridConfig):
    """The paper's codes: random points of an even grid.

    With ``decode="settled"`` views are decoded by :class:`slgaussian.semantic.decode.Decoder`, with
    ``nearest`` by :class:`slgaussian.semantic.decode.NearestCode`, as the paper does.

    Raises:
        InputError: If a setting is out of its range.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`."""
        return grid_codes(count_objects(label_maps), rng, self.dimension)


class Separated(SeparatedConfig):
    """Points of a checkerboard grid, assigned to objects by simulated annealing.

    Every second point of a grid is used: such points are farther apart in L1 than equally many of a
    full grid. If the cube has enough corners for all objects, only corners are used.

    The dimension "auto" is the smallest with which at most ``error`` of the mixtures of neighbours
    decode to a third object, or 3 if there is none.

    Raises:
        InputError: If a setting is out of its range.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`."""
        n = count_objects(label_maps)
        pairs = neighbours(label_maps)
        if self.dimension != "auto":
            return place(n, pairs, self.dimension, rng)
        for dimension in (1, 2, 3):
            codes = place(n, pairs, dimension, rng)
            if misread(codes, pairs) <= self.error:
                break
        return codes


@dataclass(frozen=True)
class Exact:
    """No codes: Gaussians carry the object itself; a pixel shows that of the largest total weight.

    This is the control: its errors are caused by geometry, additional errors of coded fields by the
    codes.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`; float32 [N, 0]."""
        return np.empty((count_objects(label_maps), 0), np.float32)


def grid_codes(n: int, rng: np.random.Generator, dimension: int = 3) -> np.ndarray:
    """Draw ``n`` distinct codes from the paper's even grid.

    Args:
        n: Number of objects, at least 1.
        rng: numpy Generator. Draws the grid points and their order.
        dimension: 1 to 3; in the paper 3.

    Returns:
        float32 [n, dimension]: Points of a grid on [0, 1]^dimension, ends included, with k points
            per axis, k the smallest integer with k^dimension >= n. A single object gets the centre.

    Raises:
        InputError: If ``n`` is less than 1.
    """
    if n < 1:
        raise InputError(f"ID codes: asked for {n}, expected at least one object")
    k = _ceil_root(n, dimension)
    levels = np.linspace(0, 1, k, dtype=np.float32) if k > 1 else np.array([0.5], np.float32)
    chosen = rng.choice(k**dimension, n, replace=False)
    return np.stack([levels[axis] for axis in np.unravel_index(chosen, (k,) * dimension)], 1)


def count_objects(label_maps: LabelMaps) -> int:
    """Count the objects; InputError if there is none."""
    n = len(label_maps.ids)
    if n == 0:
        raise InputError("ID codes: the label maps hold no object; nothing could be queried")
    return n


def _ceil_root(n: int, degree: int) -> int:
    """Compute the smallest integer k with k^degree >= n, without float errors near powers."""
    k = round(n ** (1 / degree))
    while k**degree < n:
        k += 1
    while (k - 1) ** degree >= n:
        k -= 1
    return k
