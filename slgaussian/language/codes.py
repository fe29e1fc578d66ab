"""ID codes: a low-dimensional vector for every object.

Section 3.2 of the paper: [0, 1]^3 is divided into ceil(cbrt N)^3 evenly spaced vectors and N of
them are chosen at random; a rendered vector means the object whose code is nearest in L1
(:mod:`slgaussian.language.nearest`). Codes placed with care: :mod:`slgaussian.language.separated`.
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
    """The paper's codes: points of an even grid, at random.

    With ``decode="settled"`` views are read by :class:`slgaussian.semantic.decode.Decoder`, with
    ``nearest`` by :class:`slgaussian.semantic.decode.NearestCode`, as the paper does.

    Raises
    ------
    InputError
        If a setting is out of its range.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`."""
        return grid_codes(count_objects(label_maps), rng, self.dimension)


class Separated(SeparatedConfig):
    """Every second point of a grid, as on a chessboard, given to objects by simulated annealing.

    Such points are farther from each other in L1 than as many of the whole grid. For as few objects
    as the cube has corners, the corners.

    The dimension "auto" is the smallest with which at most ``error`` of the mixtures of neighbours
    read as a third object, and three if none is.

    Raises
    ------
    InputError
        If a setting is out of its range.
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
    """No codes: Gaussians carry the object itself, and a pixel shows that with most of its light.

    The control: what it reads wrong the geometry did, and what codes read wrong besides is theirs.
    """

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """See :class:`slgaussian.language.CodeStrategy`; float32 [N, 0]."""
        return np.empty((count_objects(label_maps), 0), np.float32)


def grid_codes(n: int, rng: np.random.Generator, dimension: int = 3) -> np.ndarray:
    """Choose ``n`` distinct codes at random from the paper's even grid.

    Parameters
    ----------
    n : int
        Number of objects, at least 1.
    rng : numpy Generator
        Decides which grid points are used, and in which order.
    dimension : int
        1 to 3; in the paper 3.

    Returns
    -------
    float32 [n, dimension]
        Points of a grid with k points along each axis that spans [0, 1]^dimension with its corners,
        k the smallest integer with k^dimension >= n. A single object, for which such a grid is one
        point, gets the centre.

    Raises
    ------
    InputError
        If ``n`` is less than 1.
    """
    if n < 1:
        raise InputError(f"ID codes: asked for {n}, expected at least one object")
    k = _ceil_root(n, dimension)
    levels = np.linspace(0, 1, k, dtype=np.float32) if k > 1 else np.array([0.5], np.float32)
    chosen = rng.choice(k**dimension, n, replace=False)
    return np.stack([levels[axis] for axis in np.unravel_index(chosen, (k,) * dimension)], 1)


def count_objects(label_maps: LabelMaps) -> int:
    """Count the objects; InputError if none."""
    n = len(label_maps.ids)
    if n == 0:
        raise InputError("ID codes: the label maps hold no object; nothing could be queried")
    return n


def _ceil_root(n: int, degree: int) -> int:
    """Smallest integer k with k^degree >= n; the rounded float root alone is wrong near powers."""
    k = round(n ** (1 / degree))
    while k**degree < n:
        k += 1
    while (k - 1) ** degree >= n:
        k -= 1
    return k
