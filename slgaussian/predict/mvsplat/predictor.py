"""The predictor ``mvsplat``: context views in any units to Gaussians in the same units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from slgaussian.errors import InputError
from slgaussian.parts.identity import file_digest
from slgaussian.parts.pretrained import chosen_device
from slgaussian.parts.settings import check_settings, setting
from slgaussian.predict.mvsplat.config import PUBLISHED, Config

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.predict.mvsplat.network import Network
    from slgaussian.scene import Sample


@dataclass(frozen=True, eq=False)
class MVSplat:
    """MVSplat (Chen et al., ECCV 2024) with published weights, one Gaussian a context pixel.

    The context is two or more views; the published weights were trained with two. Images whose
    sides are no multiples of 16 lose their edges, and those pixels get no Gaussian.

    **Units.** The networks know scenes whose nearest points are about one unit away. So the scene
    is scaled to put ``near`` at 1, and the Gaussians back. Without any ``near``, it is where
    RealEstate10K has it: the 5th percentile of depths, here of triangulated matches between the
    views, over 1.25. With too few matches for that, it is the least distance between two views,
    the rule of pixelSplat for scenes of unknown scale.

    **Colour.** ``sh`` has 16 coefficients: colours depend on the direction that they are seen from.

    Attributes
    ----------
    checkpoint : path
        ``re10k.ckpt``, ``acid.ckpt`` or another of the same shape. Has no default.
    near, far : float or None
        Depth range along z in scene units. None takes the context cameras' own, the least near and
        the greatest far; and where they have none either, near as above and a far of 100 near.
    precision : "float32" or "bfloat16"
        Of the layers. Disparity, probabilities of depths, and geometry are always float32.
    depth_candidates : int or "auto"
        Disparities at which views are correlated, interpolated to the 128 that the weights were
        trained for, which says how many there are at most. "auto" takes one for each pixel of
        motion over the feature map.
    device : str
        "auto" is "cuda" where there is one, else "cpu". Gaussians come back on the CPU.
    config : Config

    Raises
    ------
    InputError
        If a setting is out of range, or the checkpoint does not fit.
    """

    checkpoint: Path | None = setting(
        None, "Weights of mvsplat, such as re10k.ckpt.", content=file_digest
    )
    near: float | None = None
    far: float | None = None
    precision: str = setting(
        "float32", "Of mvsplat's layers: float32 or bfloat16.", choices=("float32", "bfloat16")
    )
    depth_candidates: int | Literal["auto"] = setting(
        128,
        "Depths that mvsplat compares, 2 to 128, or 'auto': as many as the pair needs.",
        low=2,
    )
    device: str = "auto"
    config: Config = PUBLISHED
    network: Network = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.checkpoint is None:
            raise InputError(
                "mvsplat checkpoint: none given; download re10k.ckpt from where MVSplat's README "
                "says, and give its path, as in --set mvsplat.checkpoint=re10k.ckpt"
            )
        most = self.config.candidates
        if self.depth_candidates != "auto" and self.depth_candidates not in range(2, most + 1):
            raise InputError(
                f"mvsplat depth_candidates: found {self.depth_candidates!r}, expected 2 to {most} "
                'or "auto"'
            )
        check_settings(self, "mvsplat")
        for name, value in (("near", self.near), ("far", self.far)):
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"mvsplat {name}: found {value}, expected a positive number")
        from slgaussian.predict.mvsplat.checkpoint import load_network

        device = chosen_device(self.device)
        object.__setattr__(self, "device", device)
        network = load_network(self.checkpoint, self.config)
        try:
            network.to(device)
        except (RuntimeError, AssertionError) as problem:
            reason = str(problem).splitlines()[0]
            raise InputError(f"mvsplat device {device!r}: cannot be used ({reason})") from None
        object.__setattr__(self, "network", network)

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Gaussians in the world frame of ``sample``, one a context pixel in order of ``source``.

        Nothing is drawn at random, so ``seed`` is not looked at.

        Raises
        ------
        InputError
            If near is not below far, or images are smaller than 16 pixels a side.
        """
        from slgaussian.predict.mvsplat.inference import predict

        return predict(self, sample)
