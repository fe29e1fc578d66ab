"""Numerically hard cases, measured on the current machine in a few seconds.

Float32 kernels are compared with plain float64, or higher precision, on inputs that are known to
break such code. Compilers, processors and libraries determine the last digits, so the comparison is
done on the machine that computes the results. The tests have more cases.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from slgaussian.gaussians import Gaussians
from slgaussian.language.nearest import nearest_code
from slgaussian.language.relevancy import Scorer, sigmoid
from slgaussian.predict.unproject import unproject
from slgaussian.rasterize import PRESETS, rasterize
from slgaussian.scene import Camera

PIXELS = 1e-4
"""Largest allowed reprojection error in pixels; measured 1.4e-6 near the origin."""

EXACT = {"long list": 2e-5}
"""Larger bounds of exact rendering for cases with long float32 sums."""

FAR = np.array([1e6, -1e6, 1e6])
"""A position at which adjacent float32 coordinates are .06 units apart."""

EPS = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class HardCase:
    """Measured error of one input.

    Attributes:
        part: Computed component.
        case, about: Name of the input, and its difficulty in a line.
        measure: Meaning of ``error``.
        error, bound: A case is good if the error is below the bound; NaN always counts as a
            failure.
    """

    part: str
    case: str
    about: str
    measure: str
    error: float
    bound: float

    @property
    def good(self) -> bool:
        """Return whether the error is below its bound."""
        return self.error < self.bound


def measure_hard_cases() -> list[HardCase]:
    """Measure all cases; takes a second with compiled kernels."""
    return [*_drawings(), *_places(), *_relevancies(), *_codes()]


def _drawings() -> Iterator[HardCase]:
    """Render difficult clouds of Gaussians and compare with the float64 reference.

    The error is the maximum over values, alpha, and relative depth where alpha is above one half:
    with low alpha, the mean depth depends on the Gaussians that a cut-off drops.
    """
    rng = np.random.default_rng(0)
    n, f, width, height = 80, 30.0, 32, 24
    z = rng.uniform(2, 6, n)
    at = (rng.uniform(-0.1, 1.1, (n, 2)) - 0.5) * (width, height) / f
    means = np.column_stack([at, np.ones(n)]) * z[:, None]
    cloud = {
        "means": means,
        "scales": rng.uniform(0.01, 0.3, (n, 3)),
        "quats": rng.normal(size=(n, 4)),
        "opacities": rng.uniform(size=n),
    }
    layers = {name: np.resize(array, (50 * n, *array.shape[1:])) for name, array in cloud.items()}
    layers |= {"scales": np.full((50 * n, 3), 9.0), "opacities": np.full(50 * n, 0.0015)}
    half, angle = rng.uniform(size=n) < 0.5, rng.uniform(0, math.pi, n)
    on_edge = np.column_stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)])
    discs = {"means": 3 * means / z[:, None], "scales": [[1, 1e-6, 1]] * n, "quats": on_edge}
    decades = {"scales": 10 ** rng.uniform(-6, 3, (n, 3))}
    opaque = {"opacities": np.where(half, 1 - 1e-7, cloud["opacities"])}
    far = {"means": means * 4 + FAR, "scales": cloud["scales"] * 4}
    for case, text, changes, centre in (
        ("needles", "a million times as long as wide", {"scales": [[1, 1e-6, 1e-6]] * n}, 0),
        ("discs on edge", "large, without thickness, seen from the side", discs, 0),
        ("scales of nine decades", "a millionth to a thousand units in one Gaussian", decades, 0),
        ("opacity almost 1", "half of the Gaussians have opacity 1 - 1e-7", opaque, 0),
        ("long list", "four thousand faint layers on every pixel", layers, 0),
        ("a million units away", "where float32 places are .06 units apart", far, FAR),
    ):
        arrays = {k: torch.tensor(np.asarray(v, np.float32)) for k, v in (cloud | changes).items()}
        count = len(arrays["means"])
        source = torch.arange(count, dtype=torch.int32)
        gaussians = Gaussians(**arrays, sh=torch.zeros(count, 1, 3), source=source)
        values = torch.tensor(rng.uniform(size=(count, 3)), dtype=torch.float32)
        c2w = np.eye(4)
        c2w[:3, 3] = centre
        K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
        scene = gaussians, values, Camera(K, c2w, width, height)
        uncut = replace(PRESETS["exact"], sigmas=math.inf)
        true = rasterize(*scene, backend="reference", settings=uncut)
        solid = true.alpha > 0.5
        for preset, name, bound in (
            ("exact", "cutting nothing", EXACT.get(case, 5e-6)),
            ("fast", "by default", 0.003),
        ):
            drawn = rasterize(*scene, backend="cpu", settings=preset)
            depth = (drawn.depth.double() - true.depth)[solid] / true.depth[solid]
            differences = {
                "of values 0 to 1": drawn.values - true.values,
                "of alpha": drawn.alpha - true.alpha,
                "of depth, relative": depth,
            }
            # NaN is propagated, so it counts as a failure.
            errors = {of: float(d.abs().max()) for of, d in differences.items() if d.numel()}
            worst = max(errors, key=lambda of: math.inf if math.isnan(errors[of]) else errors[of])
            yield HardCase(f"rasteriser, {name}", case, text, worst, errors[worst], bound)


def _places() -> Iterator[HardCase]:
    """Convert depths to Gaussians, and measure their reprojection error."""
    for case, text, depths, centre in (
        ("near and far", "depths from .02 to 100,000 side by side", (0.02, 1e5), 0.0),
        ("a million units away", "where float32 places are .06 units apart", (20.0, 2000.0), 1e6),
    ):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(rng=3).as_matrix()
        pose[:3, 3] = centre, -centre, centre
        camera = Camera(np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]), pose, 32, 24)
        z = np.geomspace(*depths, 32 * 24).reshape(24, 32)
        flat = np.zeros((24, 32, 3), np.float32), np.ones((24, 32), np.float32)
        inverse = (1 / z).astype(np.float32)
        gaussians = unproject([camera], [flat[0]], [inverse], [flat[1]])
        pixels, _ = camera.project(gaussians.means.double().numpy())
        u, v = np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5)
        off = np.abs(pixels - np.stack([u, v], -1).reshape(-1, 2)).max()
        # Reprojection error of half a float32 ulp per coordinate at the smallest depth.
        step = float(np.sqrt(3) * EPS / 2 * centre * camera.K[0, 0] / depths[0])
        yield HardCase("depth to Gaussians", case, text, "pixels", float(off), PIXELS + step)


def _relevancies() -> Iterator[HardCase]:
    """Compare relevancies with the formula in extended precision."""
    rng = np.random.default_rng(0)
    base = rng.normal(size=16)
    for case, text, distance, temperature in (
        ("very sharp", "a temperature of 10,000, whose exponentials overflow float64", 1e-2, 1e4),
        ("almost the same", "objects and texts that differ in the seventh digit", 1e-7, 10.0),
    ):
        vectors = base + distance * rng.normal(size=(12, 16))
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        objects, queries, canonical = unit[:6], unit[6:9], unit[9:]
        present = np.ones((6, 1), bool)
        gaps = Scorer(objects[:, None], present, canonical).gaps(queries)
        computed = sigmoid(temperature * gaps)
        wide = [a.astype(np.longdouble) for a in (objects, queries, canonical)]
        wide = [a / np.sqrt((a * a).sum(1, keepdims=True)) for a in wide]
        query, rival = wide[1] @ wide[0].T, wide[2] @ wide[0].T
        true = 1 / (1 + np.exp(temperature * (rival[:, None] - query)))
        error = float(np.abs(computed - true.min(0)).max())
        yield HardCase("relevancy", case, text, "of relevancy 0 to 1", error, 1e-11)


def _codes() -> Iterator[HardCase]:
    """Compare the nearest-code search with brute force in float64; ties go to the first code."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 6)] * 3, indexing="ij"), -1).reshape(-1, 3)
    halfway = (grid[rng.integers(len(grid), size=4000)] + grid[rng.integers(216, size=4000)]) / 2
    for case, text, values in (
        ("halfway between codes", "ties, which the first code wins", halfway),
        ("outside the cube", "codes that rounding or noise moved out", 3 * halfway - 1),
    ):
        nearest = nearest_code(values, grid)
        plain = np.abs(values[:, None] - grid).sum(2).argmin(1)
        wrong = float((nearest != plain).mean())
        yield HardCase("nearest code", case, text, "share of other codes", wrong, 1e-9)
