"""Settings of image formation, and cut-offs that trade accuracy for time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from slgaussian.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Settings:
    """Image formation and cut-offs of a rasterizer.

    The first three define the image; every backend and the float64 reference follow them. The
    others are cut-offs of the fast backends, which the reference ignores.

    Attributes:
        near: Gaussians whose centre has z at or below this are not drawn; scene units, above 0.
        low_pass: Added to the diagonal of every projected covariance, px^2, above 0, so that no
            Gaussian falls between pixel centres (Kerbl et al. 2023 use 0.3).
        alpha_max: Upper bound of alphas, in (0, 1]; 1 does not clamp.
        alpha_min: Threshold of alpha below which a Gaussian is cut, in [0, 1); 0 cuts nothing.
        sigmas: Radius in standard deviations beyond which a Gaussian is cut; infinity cuts nothing.
        pass_min: Transmittance below which a pixel is finished, in [0, 1); 0 continues to the end.

    Raises:
        InputError: If a number is out of its range.
    """

    near: float = 0.01
    low_pass: float = 0.3
    alpha_max: float = 1.0
    alpha_min: float = 1 / 4096
    sigmas: float = math.inf
    pass_min: float = 1 / 4096

    def __post_init__(self) -> None:
        ranges = {
            "near": (0 < self.near < math.inf, "above 0"),
            "low_pass": (0 < self.low_pass < math.inf, "above 0"),
            "alpha_max": (0 < self.alpha_max <= 1, "above 0 and at most 1"),
            "alpha_min": (0 <= self.alpha_min < 1, "from 0 to below 1"),
            "sigmas": (self.sigmas > 0, "above 0"),
            "pass_min": (0 <= self.pass_min < 1, "from 0 to below 1"),
        }
        for name, (good, expected) in ranges.items():
            if not good:
                raise InputError(
                    f"rasterize settings {name}: found {getattr(self, name)}, expected {expected}"
                )


PRESETS = {
    "fast": Settings(),
    "exact": Settings(alpha_min=0.0, pass_min=0.0),
    "3dgs": Settings(near=0.2, alpha_max=0.99, alpha_min=1 / 255, sigmas=3.0, pass_min=1e-4),
}
"""Settings by name. ``fast`` is the default: errors below a grey level on real scenes. ``exact``
cuts nothing and is slow. ``3dgs`` has the constants of Kerbl et al. 2023, for comparison with other
renderers. The published MVSplat checkpoints were trained with them as well; that renderer also
assumes a centred principal point, so use a camera with one."""


def find_settings(settings: Settings | str, reach: float) -> Settings:
    """Return ``settings``, or the preset of that name for a scene that reaches so far.

    Args:
        reach: Distance of the far Gaussians, :meth:`slgaussian.gaussians.Gaussians.reach`. Below 1
            the near plane of a preset is nearer by this factor: a room in kilometres lies before
            the usual one.

    Raises:
        InputError: If there is no such preset.
    """
    if isinstance(settings, Settings):
        return settings
    if settings not in PRESETS:
        raise InputError(
            f"unknown rasterize settings {settings!r}: expected one of {', '.join(PRESETS)}, or a "
            f"Settings{did_you_mean(settings, PRESETS)}"
        )
    preset = PRESETS[settings]
    return replace(preset, near=preset.near * reach) if 0 < reach < 1 else preset
