"""How the predictor ``mvsplat`` works: scale the scene, run the network, scale it back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import inside
from slgaussian.predict.candidates import MIN_MATCHES
from slgaussian.predict.links import link_views
from slgaussian.predict.mvsplat.adapter import gaussians_of
from slgaussian.predict.mvsplat.cost_volume import needed_candidates
from slgaussian.scene import Camera, Sample, View

if TYPE_CHECKING:
    from slgaussian.predict.mvsplat.predictor import MVSplat

MULTIPLE = 16
"""Images are cropped to multiples of this: by all that downsampling, and two windows a side."""

NEAREST_DEPTH = 1.25
"""Depth of the 5th percentile of points in the training scenes, where the near plane is at 1 (Zhou
et al., "Stereo Magnification", SIGGRAPH 2018, whose clips are RealEstate10K)."""


def predict(predictor: MVSplat, sample: Sample) -> Gaussians:
    """Gaussians of the context views; see :class:`slgaussian.predict.mvsplat.predictor.MVSplat`."""
    near, far = _range(predictor, sample)
    views = [_cropped(sample.scene, view) for view in sample.context]
    unit = predictor.config.near / near
    cameras = [_scaled(view.camera, unit) for view in views]
    gaussians = _predict(predictor, views, cameras, near * unit, far * unit)
    return replace(
        gaussians,
        means=gaussians.means.div_(unit),
        scales=gaussians.scales.div_(unit),
        source=_source(sample.context[0].camera, cameras),
    )


def _range(predictor: MVSplat, sample: Sample) -> tuple[float, float]:
    """Near and far in scene units."""
    cameras = [view.camera for view in sample.context]
    near, far = predictor.near, predictor.far
    if near is None:
        near = min((c.near for c in cameras if c.near is not None), default=None)
    if near is None:
        near = estimated_near(sample.context)
    if far is None:
        own = max((c.far for c in cameras if c.far is not None), default=None)
        far = own or near * predictor.config.far / predictor.config.near
    if near >= far:
        raise InputError(
            f"scene {sample.scene!r}: near {near:.3g} is not below far {far:.3g}; give both"
        )
    return near, far


def _predict(
    predictor: MVSplat, views: Sequence[View], cameras: Sequence[Camera], near: float, far: float
) -> Gaussians:
    """In the units of ``cameras``; ``source`` counts the cropped pixels."""
    stacked = np.stack([view.image for view in views])
    images = torch.from_numpy(stacked).permute(0, 3, 1, 2).to(predictor.device)
    candidates = predictor.depth_candidates
    if candidates == "auto":
        candidates = needed_candidates(cameras, near, far, predictor.config.candidates)
    bfloat16 = predictor.precision == "bfloat16"
    with torch.no_grad(), inside(predictor.network):
        with torch.autocast(predictor.device.split(":")[0], torch.bfloat16, enabled=bfloat16):
            found = predictor.network(images.float().div_(255), cameras, near, far, candidates)
        lifted = [
            gaussians_of(disparity, raw, camera, predictor.config)
            for disparity, raw, camera in zip(found.disparity, found.raw, cameras, strict=True)
        ]
        fields = {name: torch.cat([part[name] for part in lifted]).cpu() for name in lifted[0]}
        opacities = found.opacity.flatten().cpu()
    source = torch.arange(len(opacities), dtype=torch.int32)
    return Gaussians(**fields, opacities=opacities, source=source)


def estimated_near(views: Sequence[View]) -> float:
    """Where the near plane of a scene is in its own units, as the networks know it.

    See "Units" in :class:`slgaussian.predict.mvsplat.predictor.MVSplat`. It scales with the scene.
    """
    links = link_views(views, ranged=True).links
    found = [np.concatenate([link.sparse for link in mine]) for mine in links]
    if min(map(len, found)) >= MIN_MATCHES:
        # Inverse depths: their 95th percentile is the 5th of depths.
        depths = [1 / np.percentile(inverse, 95) for inverse in found]
        return float(np.percentile(depths, 10)) / NEAREST_DEPTH
    centres = [view.camera.center for view in views]
    return min(float(np.linalg.norm(a - b)) for a, b in combinations(centres, 2))


def _cropped(scene: str, view: View) -> View:
    """The middle of a view, with sides that are multiples of 16."""
    camera = view.camera
    height, width = (length - length % MULTIPLE for length in (camera.height, camera.width))
    if height == 0 or width == 0:
        raise InputError(
            f"scene {scene!r}: {view.name!r} is {camera.width}x{camera.height}, expected at least "
            f"{MULTIPLE}x{MULTIPLE} pixels"
        )
    left, top = (camera.width - width) // 2, (camera.height - height) // 2
    image = view.image[top : top + height, left : left + width]
    return View(view.name, camera.cropped(left, top, width, height), image)


def _scaled(camera: Camera, unit: float) -> Camera:
    """The camera in a scene that is ``unit`` times as large."""
    c2w = camera.c2w.copy()
    c2w[:3, 3] *= unit
    return replace(camera, c2w=c2w, near=None, far=None)


def _source(original: Camera, cropped: Sequence[Camera]) -> torch.Tensor:
    """Flat indices of the pixels of cropped views in the originals, all of one size, int32 [N]."""
    height, width = cropped[0].height, cropped[0].width
    index = torch.arange(len(cropped) * original.height * original.width, dtype=torch.int32)
    index = index.view(len(cropped), original.height, original.width)
    top, left = (original.height - height) // 2, (original.width - width) // 2
    return index[:, top : top + height, left : left + width].flatten()
