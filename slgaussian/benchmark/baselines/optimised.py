"""Gaussians and what they carry, optimised for one scene: no feed-forward model.

As 3D Gaussian splatting (Kerbl et al. 2023) and LangSplat (arXiv 2312.16084) do it, in small: the
Gaussians start where sparse matches of the photographs say, and gradients through the rasteriser
bring their pictures to the photographs; then they are frozen, and so is each of their vectors to
images of vectors. The number of steps is fixed and nothing is drawn at random, so the same scene
gives the same bytes. There are a few hundred steps, not 30,000, the photographs are made small, and
Gaussians are neither split nor removed: a Gaussian for every few pixels is there from the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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


@dataclass(frozen=True, eq=False)
class Optimised:
    """Gaussians of a scene.

    Attributes
    ----------
    gaussians : Gaussians
        ``source`` numbers them.
    losses : float64 [steps]
        Mean absolute error of the picture of each step, levels in [0, 1].
    """

    gaussians: Gaussians
    losses: np.ndarray


def optimise(views: Sequence[View], steps: int) -> Optimised:
    """Fit Gaussians to photographs with their cameras, view by view in turn.

    Parameters
    ----------
    views : sequence of View
        Two or more.
    steps : int
        One photograph each; at least 1.
    """
    views = [small(view) for view in views]
    start, far = _start(views)
    wanted = [torch.from_numpy(view.image.astype(np.float32) / 255) for view in views]
    own = {
        "means": start.means.clone(),
        "scales": start.scales.log(),
        "quats": start.quats.clone(),
        "opacities": torch.logit(start.opacities),
        "rgb": start.colors().clone(),
    }
    rates = RATES | {"means": RATES["means"] * far}
    losses = np.empty(steps)
    with fixed(1):
        for values in own.values():
            values.requires_grad_()
        adam = torch.optim.Adam([{"params": [own[n]], "lr": rate} for n, rate in rates.items()])
        falling = torch.optim.lr_scheduler.ExponentialLR(adam, 0.1 ** (1 / steps))
        for step in range(steps):
            seen = step % len(views)
            drawn = rasterize(_assembled(start, own), own["rgb"], views[seen].camera)
            loss = (drawn.values - wanted[seen]).abs().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
            falling.step()
            losses[step] = loss.item()
        with torch.no_grad():
            made = _assembled(start, own)
            made = replace(made, sh=rgb_to_sh(own["rgb"].clamp(0, 1)))
    detached = {name: getattr(made, name).detach() for name in ("means", "scales", "quats")}
    return Optimised(replace(made, **detached, opacities=made.opacities.detach()), losses)


def fit_vectors(
    gaussians: Gaussians, cameras: Sequence[Camera], images: Sequence[np.ndarray], steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """What frozen Gaussians should carry for their drawings to be ``images``, and the losses.

    Parameters
    ----------
    gaussians : Gaussians
    cameras : sequence of Camera
        Of the size of their images.
    images : sequence of float32 [H, W, C]
        One a camera; the last number is 1 where the others are known, else 0.
    steps : int
        One image each; at least 1.

    Returns
    -------
    float32 [N, C], float64 [steps]
        The loss is the mean absolute difference; of what is not known only the last number counts.
    """
    wanted = [torch.from_numpy(np.ascontiguousarray(image)) for image in images]
    plans = [plan(gaussians, camera) for camera in cameras]
    losses = np.empty(steps)
    with fixed(1):
        carried = torch.zeros(len(gaussians), wanted[0].shape[2], requires_grad=True)
        adam = torch.optim.Adam([carried], lr=VECTOR_RATE)
        falling = torch.optim.lr_scheduler.ExponentialLR(adam, 0.1 ** (1 / steps))
        for step in range(steps):
            image = wanted[step % len(wanted)]
            known = image[..., -1:]
            off = plans[step % len(plans)].render(carried) - image
            loss = (off[..., :-1] * known).abs().mean() + off[..., -1:].abs().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
            falling.step()
            losses[step] = loss.item()
    return carried.detach().numpy(), losses


def _assembled(start: Gaussians, own: dict[str, torch.Tensor]) -> Gaussians:
    """Gaussians of numbers that may be any: logarithms of scales, logits of opacities."""
    return replace(
        start,
        means=own["means"],
        scales=own["scales"].exp(),
        quats=own["quats"],
        opacities=torch.sigmoid(own["opacities"]),
    )


def small(view: View) -> View:
    """The photograph at the size that is optimised for: at most :data:`MOST_PIXELS`."""
    height, width = view.image.shape[:2]
    share = min((MOST_PIXELS / (height * width)) ** 0.5, 1.0)
    return view.resized(max(int(height * share), 1), max(int(width * share), 1))


def _start(views: Sequence[View]) -> tuple[Gaussians, float]:
    """A ball for every few pixels, as far as the matches nearest to it, and the typical distance.

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
    """The median of what matches tell; without any the middle of the bounds, or of baselines."""
    if len(depth):
        return float(np.median(depth))
    camera = views[0].camera
    if camera.near is not None and camera.far is not None:
        return float((camera.near * camera.far) ** 0.5)
    return BASELINES * float(np.linalg.norm(views[-1].camera.center - camera.center) or 1.0)


def _matched(views: Sequence[View]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pixels float64 [M, 2] of each view whose depth [M] its matches with its neighbours tell."""
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
