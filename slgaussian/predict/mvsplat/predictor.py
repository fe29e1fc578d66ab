"""The predictor ``mvsplat``: Gaussians from context views, in the units of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import torch
from pydantic import PrivateAttr

from slgaussian.components.pretrained import resolve_device
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import inside
from slgaussian.predict.configs import MVSplatConfig
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.mvsplat.adapter import make_gaussians
from slgaussian.predict.mvsplat.checkpoint import load_network
from slgaussian.predict.mvsplat.network import Network
from slgaussian.predict.view_graph import link_views
from slgaussian.scene import Camera, Sample, View

NEAR, FAR = 1.0, 100.0
"""Range of depths, in the units of the training scenes."""

SIDE_MULTIPLE = 16
"""Image sides are cropped to multiples of this, for downsampling and two windows on each side."""

NEAREST_DEPTH = 1.25
"""5th percentile of depth in the training scenes, whose near plane is at 1 (Zhou et al., "Stereo
Magnification", SIGGRAPH 2018, the source of RealEstate10K)."""


class MVSplat(MVSplatConfig):
    """MVSplat (Chen et al., ECCV 2024) with published weights, one Gaussian a context pixel.

    The context has two or more views; the published weights were trained with two. Images whose
    sides are no multiples of 16 are cropped; the removed pixels have no Gaussian.

    **Units.** The networks were trained on scenes whose nearest points are about one unit away. So
    the scene is scaled to put the smallest ``near`` of the context cameras at 1, and the Gaussians
    are scaled back. Where no camera has one, the rule of RealEstate10K applies: the 5th percentile
    of depths, here of triangulated matches, over 1.25. With too few matches it is the smallest
    distance between two views, the rule of pixelSplat for scenes of unknown scale.

    **Precision.** Disparity, depth probabilities and geometry are float32 whatever the layers are.

    **Colour.** ``sh`` has 16 coefficients: colours depend on the viewing direction.

    Attributes:
        device: "auto" is "cuda" if available, else "cpu". Gaussians are returned on the CPU.

    Raises:
        InputError: If a setting is out of range, or the checkpoint does not fit.
    """

    device: str = "auto"
    _network: Network = PrivateAttr()

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.checkpoint is None:
            raise InputError(
                "mvsplat checkpoint: none given; download re10k.ckpt from where MVSplat's README "
                "says, and give its path, as in --set mvsplat.checkpoint=re10k.ckpt"
            )
        device = resolve_device(self.device)
        network = load_network(self.checkpoint)
        try:
            self._network = network.to(device)
        except (RuntimeError, AssertionError) as problem:
            reason = str(problem).splitlines()[0]
            raise InputError(f"mvsplat device {device!r}: cannot be used ({reason})") from None

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Predict one Gaussian for each context pixel, in the world frame of ``sample``.

        Gaussians are in the order of ``source``. ``seed`` is not used.

        Raises:
            InputError: If near is not below far, or images are smaller than 16 pixels a side.
        """
        sample, frame = sample.localize()
        near, far = _range(sample)
        views = [_crop(sample.scene, view) for view in sample.context]
        cameras = [_scale(view.camera, NEAR / near) for view in views]
        device = next(self._network.parameters()).device
        pixels = torch.from_numpy(np.stack([view.image for view in views])).to(device)
        images = pixels.permute(0, 3, 1, 2).float().div_(255)
        half = self.precision == "bfloat16"
        with torch.no_grad(), inside(self._network):
            with torch.autocast(device.type, torch.bfloat16, enabled=half):
                output = self._network(images, cameras, NEAR, far * (NEAR / near))
            of_views = zip(output.disparity, output.raw, cameras, strict=True)
            parts = [make_gaussians(*of_view) for of_view in of_views]
            fields: Any = {
                name: torch.cat([part[name] for part in parts]).cpu() for name in parts[0]
            }
        for name in ("means", "scales"):
            fields[name].div_(NEAR / near)
        source = _source_indices(sample.context[0].camera, cameras)
        opacities = output.opacity.flatten().cpu()
        return Gaussians(**fields, opacities=opacities, source=source).place(frame)


def _range(sample: Sample) -> tuple[float, float]:
    """Return near and far in scene units; without a far it is 100 times near."""
    cameras = [view.camera for view in sample.context]
    near = min((c.near for c in cameras if c.near is not None), default=None)
    if near is None:
        near = estimate_near(sample)
    far = max((c.far for c in cameras if c.far is not None), default=near * FAR / NEAR)
    if near >= far:
        raise InputError(
            f"scene {sample.scene!r}: near {near:.3g} is not below far {far:.3g}; give both"
        )
    return near, far


def estimate_near(sample: Sample) -> float:
    """Estimate the near plane that the networks expect, in the units of the scene.

    See "Units" in :class:`slgaussian.predict.mvsplat.predictor.MVSplat`.
    """
    links = link_views(sample, ranged=True).links
    sparse = [np.concatenate([link.sparse for link in sources]) for sources in links]
    if min(map(len, sparse)) >= MIN_MATCHES:
        # The 95th percentile of inverse depths is the 5th of depths.
        depths = [1 / np.percentile(inverse, 95) for inverse in sparse]
        return float(np.percentile(depths, 10)) / NEAREST_DEPTH
    centres = [view.camera.center for view in sample.context]
    return min(float(np.linalg.norm(a - b)) for a, b in combinations(centres, 2))


def _crop(scene: str, view: View) -> View:
    """Crop the centre of a view to sides that are multiples of 16."""
    camera = view.camera
    height, width = (length - length % SIDE_MULTIPLE for length in (camera.height, camera.width))
    if height == 0 or width == 0:
        raise InputError(
            f"scene {scene!r}: {view.name!r} is {camera.width}x{camera.height}, expected at least "
            f"{SIDE_MULTIPLE}x{SIDE_MULTIPLE} pixels"
        )
    left, top = (camera.width - width) // 2, (camera.height - height) // 2
    image = view.image[top : top + height, left : left + width]
    return View(view.name, camera.crop(left, top, width, height), image)


def _scale(camera: Camera, unit: float) -> Camera:
    """Return the camera in a scene scaled by ``unit``."""
    c2w = camera.c2w.copy()
    c2w[:3, 3] *= unit
    return replace(camera, c2w=c2w, near=None, far=None)


def _source_indices(original: Camera, cropped: Sequence[Camera]) -> torch.Tensor:
    """Return flat indices of cropped pixels in the originals, all of one size, int32 [N]."""
    height, width = cropped[0].height, cropped[0].width
    size = len(cropped), original.height, original.width
    index = torch.arange(len(cropped) * size[1] * size[2], dtype=torch.int32).view(size)
    top, left = (original.height - height) // 2, (original.width - width) // 2
    return index[:, top : top + height, left : left + width].flatten()
