"""Gaussians and what they carry, optimised for one scene: no feed-forward model.

As 3D Gaussian splatting (Kerbl et al. 2023) and LangSplat (arXiv 2312.16084) do it, in small: the
Gaussians start where sparse matches of the photographs say, and gradients through the rasteriser
bring their pictures to the photographs; then they are frozen, and so is each of their vectors to
images of vectors. The number of steps is fixed and nothing is drawn at random, so the same scene
gives the same bytes. There are a few hundred steps, not 30,000, the photographs are made small, and
Gaussians are neither split nor removed: a Gaussian for every few pixels is there from the start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from slgaussian.cameras.matches import sift_matches
from slgaussian.cameras.relative import Relative
from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.kernels.threads import fixed
from slgaussian.predict.pose import GATE
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.planned import plan
from slgaussian.scene import Camera, View

MOST_PIXELS = 60_000
"""Of a photograph that is optimised for: 208 x 288 of 416 x 576."""

SPACING = 2
"""Pixels of these between Gaussians at the start."""

RATES = {"means": 2e-3, "scales": 0.02, "quats": 0.01, "opacities": 0.05, "rgb": 0.01}
"""Of Adam; that of the means is a share of the distance of what is seen. All fall to a tenth."""

VECTOR_RATE = 0.05

BASELINES = 5.0
"""Distances between the first and the last camera that things are away, where nothing says it."""

NEAREST = 3
"""Matches that say how far a Gaussian is at the start: their median."""


def optimise(views: Sequence[View], steps: int) -> tuple[Gaussians, np.ndarray]:
    """Fit Gaussians to two posed photographs or more, one a step, view by view in turn.

    Returns the Gaussians, whose ``source`` numbers them, and the mean absolute error of the picture
    of each step, levels in [0, 1]: float64 [steps].
    """
    views = [small(view) for view in views]
    start, far = _start(views)
    wanted = [torch.from_numpy(view.image.astype(np.float32) / 255) for view in views]
    fitted = {
        "means": start.means.clone(),
        "scales": start.scales.log(),
        "quats": start.quats.clone(),
        "opacities": torch.logit(start.opacities),
        "rgb": start.colors().clone(),
    }
    for values in fitted.values():
        values.requires_grad_()
    rates = RATES | {"means": RATES["means"] * far}

    def loss(step: int) -> torch.Tensor:
        seen = step % len(views)
        drawn = rasterize(_assembled(start, fitted), fitted["rgb"], views[seen].camera)
        return (drawn.values - wanted[seen]).abs().mean()

    groups = [{"params": [fitted[name]], "lr": rate} for name, rate in rates.items()]
    losses = _descend(groups, loss, steps)
    detached = {name: values.detach() for name, values in fitted.items()}
    colours = rgb_to_sh(detached["rgb"].clamp(0, 1))
    return replace(_assembled(start, detached), sh=colours), losses


def fit_vectors(
    gaussians: Gaussians, cameras: Sequence[Camera], images: Sequence[np.ndarray], steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Find what frozen Gaussians should carry for their drawings to be ``images``, one a step.

    ``images`` are float32 [H, W, C], one a camera and of its size; the last number is 1 where the
    others are known, else 0. Returns the vectors float32 [N, C] and the losses float64 [steps]: the
    mean absolute difference; of what is not known only the last number counts.
    """
    wanted = [torch.from_numpy(np.ascontiguousarray(image)) for image in images]
    plans = [plan(gaussians, camera) for camera in cameras]
    carried = torch.zeros(len(gaussians), wanted[0].shape[2], requires_grad=True)

    def loss(step: int) -> torch.Tensor:
        image = wanted[step % len(wanted)]
        known = image[..., -1:]
        off = plans[step % len(plans)].render(carried) - image
        return (off[..., :-1] * known).abs().mean() + off[..., -1:].abs().mean()

    losses = _descend([{"params": [carried], "lr": VECTOR_RATE}], loss, steps)
    return carried.detach().numpy(), losses


def _descend(
    groups: list[dict[str, Any]], loss: Callable[[int], torch.Tensor], steps: int
) -> np.ndarray:
    """Take steps of Adam with rates that fall to a tenth, on one thread; return the losses."""
    losses = np.empty(steps)
    with fixed(1):
        adam = torch.optim.Adam(groups)
        falling = torch.optim.lr_scheduler.ExponentialLR(adam, 0.1 ** (1 / steps))
        for step in range(steps):
            value = loss(step)
            adam.zero_grad()
            value.backward()
            adam.step()
            falling.step()
            losses[step] = value.item()
    return losses


def _assembled(start: Gaussians, own: dict[str, torch.Tensor]) -> Gaussians:
    """Return Gaussians of logarithms of scales and logits of opacities."""
    return replace(
        start,
        means=own["means"],
        scales=own["scales"].exp(),
        quats=own["quats"],
        opacities=torch.sigmoid(own["opacities"]),
    )


def small(view: View) -> View:
    """Return the photograph at the size that is optimised for: at most :data:`MOST_PIXELS`."""
    height, width = view.image.shape[:2]
    share = min((MOST_PIXELS / (height * width)) ** 0.5, 1.0)
    return view.resized(max(int(height * share), 1), max(int(width * share), 1))


def _start(views: Sequence[View]) -> tuple[Gaussians, float]:
    """Return a ball for every few pixels, as far as its nearest matches, and the typical distance.

    A view without a match takes the typical distance of the others.
    """
    parts, depths = [], _matched(views)
    typical = _typical(views, np.concatenate([depth for _, depth in depths]))
    for view, (points, depth) in zip(views, depths, strict=True):
        camera, (height, width) = view.camera, view.image.shape[:2]
        y, x = np.mgrid[0:height:SPACING, 0:width:SPACING]
        pixels = np.stack([x.ravel(), y.ravel()], 1) + 0.5 * SPACING
        if len(depth):
            near = cKDTree(points).query(pixels, k=min(NEAREST, len(depth)))[1]
            far = np.median(depth[near.reshape(len(pixels), -1)], axis=1)
        else:
            far = np.full(len(pixels), typical)
        rays = np.c_[pixels, np.ones(len(pixels))] @ np.linalg.inv(camera.K).T
        means = (rays * far[:, None]) @ camera.c2w[:3, :3].T + camera.center
        radius = 0.5 * SPACING * far / camera.K[0, 0]
        colours = view.image[y.ravel(), x.ravel()] / 255
        parts.append((means, radius, colours, far))
    means, radius, colours, far = (np.concatenate(each) for each in zip(*parts, strict=True))
    n = len(means)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    made = Gaussians(
        torch.from_numpy(means.astype(np.float32)),
        torch.from_numpy(np.repeat(radius[:, None], 3, 1).astype(np.float32)),
        torch.from_numpy(quats),
        torch.full((n,), 0.5),
        rgb_to_sh(torch.from_numpy(colours.astype(np.float32))),
        torch.arange(n, dtype=torch.int32),
    )
    return made, float(np.median(far))


def _typical(views: Sequence[View], depth: np.ndarray) -> float:
    """Return the median depth of matches; without any the middle of the bounds, or of baselines."""
    if len(depth):
        return float(np.median(depth))
    camera = views[0].camera
    if camera.near is not None and camera.far is not None:
        return float((camera.near * camera.far) ** 0.5)
    return BASELINES * float(np.linalg.norm(views[-1].camera.center - camera.center) or 1.0)


def _matched(views: Sequence[View]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pixels float64 [M, 2] and depths [M] of each view by matches with its neighbours."""
    found: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in views]
    for a in range(len(views) - 1):
        one, other = views[a], views[a + 1]
        there = Relative.between(one.camera, other.camera)
        here, beside = sift_matches(one.grey, other.grey)
        if not len(here):
            continue
        fits = np.abs(there.epipolar_distance(here, beside)) < GATE * np.hypot(*one.grey.shape)
        here, beside = here[fits], beside[fits]
        nearness = there.triangulate(here, beside), there.reversed().triangulate(beside, here)
        front = (nearness[0] > 0) & (nearness[1] > 0)
        found[a].append((here[front], 1 / nearness[0][front]))
        found[a + 1].append((beside[front], 1 / nearness[1][front]))
    nothing = np.zeros((0, 2)), np.zeros(0)
    return [
        (np.concatenate([p for p, _ in own]), np.concatenate([d for _, d in own]))
        if own
        else nothing
        for own in found
    ]
