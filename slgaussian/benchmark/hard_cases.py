"""Numerically hard cases, measured on the current machine in a few seconds.

Kernels are compared with float64, or higher precision, on inputs known to break such code.
Compilers, processors and libraries determine the last digits, so the machine that computes results
is the one to measure. The tests have more cases.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from slgaussian.gaussians import Gaussians
from slgaussian.language.nearest import nearest_code
from slgaussian.language.scoring import Scorer, sigmoid
from slgaussian.predict.unproject import unproject
from slgaussian.rasterize import PRESETS, rasterize
from slgaussian.scene import Camera

K = np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]])
WIDTH, HEIGHT = 32, 24
FAR_POSITION = np.array([1e6, -1e6, 1e6])
"""A position at which adjacent float32 coordinates are .06 units apart."""


@dataclass(frozen=True)
class HardCase:
    """Measured error of one input.

    Attributes:
        part, case: Component, and name of the input.
        measure: Meaning of ``error``.
        error, bound: A case is good if the error is below the bound; NaN never is.
    """

    part: str
    case: str
    measure: str
    error: float
    bound: float

    @property
    def good(self) -> bool:
        """Return whether the error is below its bound."""
        return self.error < self.bound


def measure_hard_cases() -> list[HardCase]:
    """Measure all cases; takes a second with compiled kernels."""
    return [*_renderings(), *_unprojections(), *_relevancies(), *_codes()]


def _renderings() -> Iterator[HardCase]:
    """Render difficult Gaussians and compare with the float64 reference.

    The error is the largest of values, alpha, and relative depth where alpha is above one half:
    with low alpha, the mean depth depends on the Gaussians that a cut-off drops.
    """
    rng, n = np.random.default_rng(0), 80
    z = rng.uniform(2, 6, n)
    at = (rng.uniform(-0.1, 1.1, (n, 2)) - 0.5) * (WIDTH, HEIGHT) / K[0, 0]
    rays = np.column_stack([at, np.ones(n)])
    cloud: dict[str, Any] = {
        "means": rays * z[:, None],
        "scales": rng.uniform(0.01, 0.3, (n, 3)),
        "quats": rng.normal(size=(n, 4)),
        "opacities": rng.uniform(size=n),
    }
    opaque, angle = rng.uniform(size=n) < 0.5, rng.uniform(0, math.pi, n)
    on_edge = np.column_stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)])
    layers = {name: np.resize(array, (50 * n, *array.shape[1:])) for name, array in cloud.items()}
    layers |= {"scales": np.full((50 * n, 3), 9.0), "opacities": np.full(50 * n, 0.0015)}
    discs = {"means": 3 * rays, "scales": [[1, 1e-6, 1]] * n, "quats": on_edge}
    far = {"means": cloud["means"] * 4 + FAR_POSITION, "scales": cloud["scales"] * 4}
    inputs: dict[str, dict[str, Any]] = {
        "needles": {"scales": [[1, 1e-6, 1e-6]] * n},
        "discs on edge": discs,
        "scales of nine decades": {"scales": 10 ** rng.uniform(-6, 3, (n, 3))},
        "opacity almost 1": {"opacities": np.where(opaque, 1 - 1e-7, cloud["opacities"])},
        "long list": layers,  # four thousand on every pixel
        "a million units away": far,
    }
    for case, changes in inputs.items():
        arrays = {k: np.asarray(v, np.float32) for k, v in (cloud | changes).items()}
        count = len(arrays["means"])
        arrays |= {
            "sh": np.zeros((count, 1, 3), np.float32),
            "source": np.arange(count, dtype="i4"),
        }
        values = torch.tensor(rng.uniform(size=(count, 3)), dtype=torch.float32)
        c2w = np.eye(4)
        c2w[:3, 3] = FAR_POSITION if changes is far else 0
        scene = Gaussians.from_arrays(arrays), values, Camera(K, c2w, WIDTH, HEIGHT)
        uncut = replace(PRESETS["exact"], sigmas=math.inf)
        true = rasterize(*scene, backend="reference", settings=uncut)
        solid = true.alpha > 0.5
        exact = 2e-5 if changes is layers else 5e-6  # sums of many float32 numbers
        for preset, name, bound in (
            ("exact", "cutting nothing", exact),
            ("fast", "by default", 3e-3),
        ):
            drawn = rasterize(*scene, backend="cpu", settings=preset)
            differences = {
                "of values 0 to 1": drawn.values - true.values,
                "of alpha": drawn.alpha - true.alpha,
                "of depth, relative": ((drawn.depth - true.depth) / true.depth)[solid],
            }
            errors = {of: float(d.abs().max()) for of, d in differences.items() if d.numel()}
            worst = max(errors, key=lambda of: (math.isnan(errors[of]), errors[of]))
            yield HardCase(f"rasterizer, {name}", case, worst, errors[worst], bound)


def _unprojections() -> Iterator[HardCase]:
    """Measure the reprojection error of unprojected depths."""
    for case, depths, centre in (
        ("near and far", (0.02, 1e5), 0 * FAR_POSITION),
        ("a million units away", (20.0, 2000.0), FAR_POSITION),
    ):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.random(rng=3).as_matrix(), centre
        camera = Camera(K, pose, WIDTH, HEIGHT)
        inverse = (1 / np.geomspace(*depths, HEIGHT * WIDTH)).astype(np.float32)
        ones = np.ones((HEIGHT, WIDTH), np.float32)
        black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        gaussians = unproject([camera], [black], [inverse.reshape(HEIGHT, WIDTH)], [ones])
        pixels, _ = camera.project(gaussians.means.double().numpy())
        deviation = np.abs(pixels - np.indices((HEIGHT, WIDTH))[::-1].reshape(2, -1).T - 0.5).max()
        # 1e-4, and the reprojection of half a float32 ulp a coordinate at the smallest depth.
        half = math.sqrt(3) * 2**-24 * centre[0] * K[0, 0] / depths[0]
        yield HardCase("depth to Gaussians", case, "pixels", float(deviation), 1e-4 + float(half))


def _relevancies() -> Iterator[HardCase]:
    """Compare relevancies with the formula in extended precision."""
    rng = np.random.default_rng(0)
    base = rng.normal(size=16)
    for case, distance, temperature in (
        ("very sharp", 1e-2, 1e4),  # exponentials overflow float64
        ("almost the same", 1e-7, 10.0),  # objects and texts differ in the seventh digit
    ):
        vectors = base + distance * rng.normal(size=(12, 16))
        unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        scorer = Scorer(unit[:6, None], np.ones((6, 1), bool), unit[9:])
        computed = sigmoid(temperature * scorer.gaps(unit[6:9]))
        wide = unit.astype(np.longdouble)
        wide /= np.sqrt((wide * wide).sum(1, keepdims=True))
        query, rival = wide[6:9] @ wide[:6].T, wide[9:] @ wide[:6].T
        true = 1 / (1 + np.exp(temperature * (rival[:, None] - query)))
        error = float(np.abs(computed - true.min(0)).max())
        yield HardCase("relevancy", case, "of relevancy 0 to 1", error, 1e-11)


def _codes() -> Iterator[HardCase]:
    """Compare the nearest-code search with brute force in float64; ties go to the first code."""
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 6)] * 3, indexing="ij"), -1).reshape(-1, 3)
    halfway = grid[rng.integers(len(grid), size=(2, 4000))].mean(0)
    for case, values in ("halfway between codes", halfway), ("outside the cube", 3 * halfway - 1):
        nearest = np.abs(values[:, None] - grid).sum(2).argmin(1)
        wrong = float((nearest_code(values, grid) != nearest).mean())
        yield HardCase("nearest code", case, "share of other codes", wrong, 1e-9)
