"""Optimisation of Gaussians for one scene from its photographs, and of codes through them.

This is the geometry of LangSplat (arXiv 2312.16084) and similar methods: 3D Gaussian splatting
(Kerbl et al. 2023), section 5, with the learning rates and thresholds of gsplat's
``simple_trainer`` (Apache-2.0). Gaussians with a large pixel gradient are cloned, or split if they
are large, and faint ones are removed, all in the first half of the steps. Differences: the loss is
L1 without SSIM, which would take half of the time; initial points are matches triangulated by the
given cameras; colours are view-independent, because two views do not determine more; the optimiser
is reset after each refinement; opacities are not; there are about a thousand steps, not 30,000.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch.nn import functional as F

from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.relative import Relative
from slgaussian.gaussians import SH_C0, Gaussians, rotation_matrices
from slgaussian.kernels.threads import LARGE_THREADS, fixed
from slgaussian.rasterize import rasterize
from slgaussian.scene import View

LEAST_POINTS = 1000
"""Smallest number of initial points. If there are fewer matches, random points are added at a half
to twice the median depth of the matches."""

UNKNOWN_DEPTH = 10
"""Assumed median depth without matches, in distances between the first and the last camera."""

INLIER = 2.0
"""Largest epipolar distance of a match that gives an initial point, pixels."""

RATES = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh": 2.5e-3}
"""Learning rates of Adam; that of the means is relative to the scene extent, and decays to 1 %."""

CODE_RATE = 2.5e-3
"""Learning rate of Adam for codes."""

REFINE_FROM, REFINE_EVERY = 100, 50
"""First step of refinement (cloning, splitting, removal), and its interval in steps."""

LEAST_GRADIENT, LARGE, FAINT = 2e-4, 0.01, 0.005
"""Mean gradient, in an image of width 2, above which a Gaussian is cloned or split; standard
deviation over the extent above which it is split; opacity below which it is removed."""


def optimise_gaussians(views: Sequence[View], seed: int, steps: int) -> Gaussians:
    """Fit Gaussians to photographs with cameras by Adam, one photograph per step in turn.

    Args:
        views: sequence of View
        seed: Seed of random points, rotations and splits; the same seed gives the same bytes.

    Returns:
        Gaussians: Harmonics of degree 0; ``source`` numbers them from 0.
    """
    generator = torch.Generator().manual_seed(seed % 2**63)
    photographs = [torch.from_numpy(view.image.astype(np.float32) / 255) for view in views]
    points, colours = _starting_points(views, np.random.default_rng(seed))
    centres = np.stack([view.camera.c2w[:3, 3] for view in views])
    extent = float(np.median(np.linalg.norm(points[:, None] - centres, axis=2)))
    nearest = cKDTree(points).query(points, 4)[0][:, 1:]
    spacing = np.sqrt((nearest**2).mean(1)).clip(1e-7 * extent)
    count = len(points)
    parameters = {
        "means": torch.tensor(points, dtype=torch.float32),
        "scales": torch.tensor(np.log(spacing)[:, None].repeat(3, 1), dtype=torch.float32),
        "quats": F.normalize(torch.rand(count, 4, generator=generator) + 1e-3, dim=1),
        "opacities": torch.full((count,), 0.1).logit(),
        "sh": torch.tensor((colours - 0.5) / SH_C0, dtype=torch.float32)[:, None],
    }
    with fixed(LARGE_THREADS):
        return _fit(parameters, views, photographs, extent, generator, steps)


def _fit(
    parameters: dict[str, torch.Tensor],
    views: Sequence[View],
    photographs: Sequence[torch.Tensor],
    extent: float,
    generator: torch.Generator,
    steps: int,
) -> Gaussians:
    """Optimise ``parameters``, the arguments of :func:`_gaussians`; ``extent`` of the scene is in
    scene units."""
    optimiser = _adam(parameters, extent)
    gradients = torch.zeros(2, len(parameters["means"]))  # sums, and numbers of views
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = RATES["means"] * extent * 0.01 ** (step / steps)
        view, photograph = views[step % len(views)], photographs[step % len(views)]
        drawn = rasterize(_gaussians(parameters), None, view.camera)
        loss = (drawn.values - photograph).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step < steps // 2:
            lengths = _pixel_gradients(parameters["means"], view)
            gradients += torch.stack([lengths, (lengths > 0).float()])
            if step >= REFINE_FROM and step % REFINE_EVERY == 0:
                mean = gradients[0] / gradients[1].clamp(min=1)
                parameters = _refined(parameters, mean > LEAST_GRADIENT, LARGE * extent, generator)
                optimiser = _adam(parameters, extent)
                gradients = torch.zeros(2, len(parameters["means"]))
    with torch.no_grad():
        return _gaussians({name: value.detach() for name, value in parameters.items()})


def optimise_codes(
    gaussians: Gaussians, views: Sequence[View], codes: np.ndarray, steps: int
) -> np.ndarray:
    """Fit one code per Gaussian, float32 [N, D], to rendered code maps by the L1 loss.

    ``codes`` is float32 [V, H, W, D]; pixels without a code are zero and are ignored.
    """
    targets = torch.from_numpy(codes)
    labelled = targets.abs().sum(-1, keepdim=True) > 0
    carried = torch.zeros(len(gaussians), codes.shape[-1], requires_grad=True)
    optimiser = torch.optim.Adam([carried], lr=CODE_RATE)
    with fixed(LARGE_THREADS):
        for step in range(steps):
            k = step % len(views)
            drawn = rasterize(gaussians, carried, views[k].camera).values
            loss = ((drawn - targets[k]).abs() * labelled[k]).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    return carried.detach().numpy()


def _starting_points(
    views: Sequence[View], generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return initial points float64 [N, 3] and their colours [N, 3] in [0, 1]."""
    graph = MatchGraph.of(views)
    points, colours, depths = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for i, j in graph.matches:
        at_a, at_b = graph.points(i, j)
        relative = Relative.between(views[i].camera, views[j].camera)
        inverse = relative.triangulate(at_a, at_b)
        fits = np.abs(relative.epipolar_distance(at_a, at_b)) < INLIER
        fits &= (inverse > 0) & (relative.reversed().triangulate(at_b, at_a) > 0)
        depths.append(1 / inverse[fits])
        points.append(_points(views[i], at_a[fits], depths[-1]))
        colours.append(_colours(views[i], at_a[fits]))
    count = sum(map(len, depths))
    baseline = np.linalg.norm(views[0].camera.center - views[-1].camera.center)
    middle = np.median(np.concatenate(depths)) if count else UNKNOWN_DEPTH * baseline
    missing = LEAST_POINTS - count
    for view in views if missing > 0 else ():
        share = -(-missing // len(views))
        pixels = generator.random((share, 2)) * [view.camera.width, view.camera.height]
        points.append(_points(view, pixels, middle * 2.0 ** generator.uniform(-1, 1, share)))
        colours.append(_colours(view, pixels))
    return np.concatenate(points), np.concatenate(colours)


def _points(view: View, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Unproject pixels [M, 2] with z-depths [M] to world points [M, 3]."""
    rays = np.c_[pixels, np.ones(len(pixels))] @ np.linalg.inv(view.camera.K).T
    return view.camera.center + (rays * depth[:, None]) @ view.camera.c2w[:3, :3].T


def _colours(view: View, pixels: np.ndarray) -> np.ndarray:
    """Return the colours [M, 3] in [0, 1] at pixels [M, 2]."""
    limits = view.camera.width - 1, view.camera.height - 1
    column, row = np.clip(pixels.astype(int), 0, limits).T
    return view.image[row, column] / 255


def _gaussians(parameters: dict[str, torch.Tensor]) -> Gaussians:
    """Make Gaussians from log scales, logit opacities and the other parameters unchanged."""
    return Gaussians(
        means=parameters["means"],
        scales=parameters["scales"].exp(),
        quats=F.normalize(parameters["quats"], dim=1),
        opacities=parameters["opacities"].sigmoid(),
        sh=parameters["sh"],
        source=torch.arange(len(parameters["means"]), dtype=torch.int32),
    )


def _adam(parameters: dict[str, torch.Tensor], extent: float) -> torch.optim.Adam:
    rates = {**RATES, "means": RATES["means"] * extent}
    groups = [{"params": [parameters[n].requires_grad_()], "lr": rates[n]} for n in RATES]
    return torch.optim.Adam(groups, eps=1e-15)


def _pixel_gradients(means: torch.Tensor, view: View) -> torch.Tensor:
    """Return norms [N] of the gradient by the projected centre, in an image of width 2."""
    assert means.grad is not None
    c2w = torch.from_numpy(view.camera.c2w).float()
    across = means.grad @ c2w[:3, :2]
    depth = ((means.detach() - c2w[:3, 3]) @ c2w[:3, 2]).clamp(min=0)
    half = torch.tensor([view.camera.width, view.camera.height]) / 2
    focal = torch.from_numpy(np.diag(view.camera.K)[:2].copy()).float()
    return (across * depth[:, None] * half / focal).norm(dim=1)


def _refined(
    parameters: dict[str, torch.Tensor],
    doubles: torch.Tensor,
    large: float,
    generator: torch.Generator,
) -> dict[str, torch.Tensor]:
    """Return the parameters after one refinement.

    Gaussians marked in ``doubles`` bool [N] are cloned, or split if their largest standard
    deviation is above ``large``, scene units; faint ones are removed.
    """
    with torch.no_grad():
        splits = doubles & (parameters["scales"].max(1).values.exp() > large)
        stays = torch.cat([~splits, doubles, splits])
        table = {n: torch.cat([v, v, v]) for n, v in parameters.items()}
        halves = torch.cat([torch.zeros_like(splits), splits, splits])
        steps = torch.randn(int(halves.sum()), 3, generator=generator)
        steps *= table["scales"][halves].exp()
        turned = rotation_matrices(table["quats"][halves]) @ steps[..., None]
        table["means"][halves] += turned[..., 0]
        table["scales"][halves] -= np.log(1.6)
        stays &= table["opacities"].sigmoid() > FAINT
        return {name: value[stays].clone() for name, value in table.items()}
