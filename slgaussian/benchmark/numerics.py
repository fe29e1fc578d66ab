"""Hard cases of the machine at hand: what float32 and its kernels make of them, in seconds.

What is computed fast is compared with plain float64, or longer numbers, on named inputs that are
known to break such code. Compilers, processors and libraries decide the last digits, so that this
is worth doing where results are made. The tests do it on more cases.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slgaussian.language.nearest import nearest_code
from slgaussian.language.relevancy import relevancy
from slgaussian.predict.unproject import unproject
from slgaussian.rasterize import hard_cases

DRAWN = (
    "ordinary_cloud", "a_gaussian_per_pixel", "at_the_near_plane", "far_off_axis", "needles",
    "pancakes_on_edge", "scales_of_nine_decades", "mixed_huge_and_tiny", "opacity_almost_1",
    "long_list", "equal_depths", "a_million_units_away",
)  # fmt: skip
"""Of the hard cases of the rasteriser those that are drawn here: one of each kind."""

PIXELS = 1e-4
"""How far off a pixel may come back. Measured 1.4e-6, where float32 places are near."""

EPS = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class HardCase:
    """What was measured of one input.

    Attributes
    ----------
    part : str
        What computes it.
    case, about : str
        The name of the input, and in a line what is hard.
    measure : str
        What ``error`` is.
    error, bound : float
        A case is good if the error is below the bound; NaN is below nothing.
    """

    part: str
    case: str
    about: str
    measure: str
    error: float
    bound: float

    @property
    def good(self) -> bool:
        """Whether the error is below its bound."""
        return self.error < self.bound


def measured() -> list[HardCase]:
    """All cases, in a few seconds where kernels are compiled."""
    return [*_drawings(), *_places(), *_relevancies(), *_codes()]


def _drawings() -> Iterator[HardCase]:
    for preset, said in (("exact", "cutting nothing"), ("fast", "by default")):
        for name in DRAWN:
            made, found = hard_cases.case(name), hard_cases.measure(name, preset)
            error, bound = found.worst(hard_cases.bounds(name, preset))
            worst = next(key for key, value in vars(found).items() if value is error)
            yield HardCase(
                f"rasteriser, {said}",
                name.replace("_", " "),
                made.about,
                {"values": "of values 0 to 1", "alpha": "of alpha", "depth": "of depth, relative"}[
                    worst
                ],
                error,
                bound,
            )


def _places() -> Iterator[HardCase]:
    """Depths become Gaussians, and these are seen again at their pixels."""
    for case, about, depths, centre in (
        ("near and far", "depths from .02 to 100,000 side by side", (0.02, 1e5), 0.0),
        ("a million units away", "where float32 places are .06 units apart", (20.0, 2000.0), 1e6),
    ):
        pose = hard_cases.rotated(3, (centre, -centre, centre))
        seen = hard_cases.camera(32, 24, 30, c2w=pose)
        z = np.geomspace(*depths, 32 * 24).reshape(24, 32)
        flat = np.zeros((24, 32, 3), np.float32), np.ones((24, 32), np.float32)
        inverse = (1 / z).astype(np.float32)
        made = unproject([seen], [flat[0]], [inverse], [flat[1]])
        pixels, _ = seen.project(made.means.double().numpy())
        u, v = np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5)
        off = np.abs(pixels - np.stack([u, v], -1).reshape(-1, 2)).max()
        # Half a float32 step of each world coordinate, seen from the least depth.
        step = float(np.sqrt(3) * EPS / 2 * centre * seen.K[0, 0] / depths[0])
        yield HardCase("depth to Gaussians", case, about, "pixels", float(off), PIXELS + step)


def _relevancies() -> Iterator[HardCase]:
    """Against the formula as it is printed, in the longest numbers there are."""
    rng = np.random.default_rng(0)
    base = rng.normal(size=16)
    for case, about, apart, temperature in (
        ("very sharp", "a temperature of 10,000, whose exponentials overflow float64", 1e-2, 1e4),
        ("almost the same", "objects and texts that differ in the seventh digit", 1e-7, 10.0),
    ):
        vectors = base + apart * rng.normal(size=(12, 16))
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        objects, queries, canonical = unit[:6], unit[6:9], unit[9:]
        found = relevancy(objects[:, None], np.ones((6, 1), bool), queries, canonical, temperature)
        wide = [a.astype(np.longdouble) for a in (objects, queries, canonical)]
        wide = [a / np.sqrt((a * a).sum(1, keepdims=True)) for a in wide]
        query, rival = wide[1] @ wide[0].T, wide[2] @ wide[0].T
        true = 1 / (1 + np.exp(temperature * (rival[:, None] - query)))
        error = float(np.abs(found - true.min(0)).max())
        yield HardCase("relevancy", case, about, "of relevancy 0 to 1", error, 1e-11)


def _codes() -> Iterator[HardCase]:
    """Rendered codes, against every code compared in float64; ties go to the first."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 6)] * 3, indexing="ij"), -1).reshape(-1, 3)
    halfway = (grid[rng.integers(len(grid), size=4000)] + grid[rng.integers(216, size=4000)]) / 2
    for case, about, values in (
        ("halfway between codes", "ties, which the first code wins", halfway),
        ("outside the cube", "codes that rounding or noise moved out", 3 * halfway - 1),
    ):
        found = nearest_code(values, grid)
        plain = np.abs(values[:, None] - grid).sum(2).argmin(1)
        wrong = float((found != plain).mean())
        yield HardCase("nearest code", case, about, "share of other codes", wrong, 1e-9)
