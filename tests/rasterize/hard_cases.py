"""Scenes on which rasterisers break, by name, and the error of the cpu backend on each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import PRESETS, Render, Settings, rasterize
from slgaussian.scene import Camera
from tests.pinhole import camera


class Case(NamedTuple):
    """One scene and the camera that sees it."""

    gaussians: Gaussians
    values: torch.Tensor
    camera: Camera


class Errors(NamedTuple):
    """Largest differences from the reference: absolute, but for ``depth``.

    ``depth`` is relative, where alpha is above one half: with little light, the mean depth is
    decided by whatever a cut-off drops.
    """

    values: float
    alpha: float
    depth: float


EXACT_BOUND = 5e-6
"""Of what cuts nothing. Measured: at most 3.7e-6 in any channel, in alpha and in relative depth,
most cases 5e-7; float32 sums are good for 1e-7 a number."""
LONGER = {
    "ten_thousand_on_one_pixel": 1e-4,  # measured 6.2e-5: 1 - alpha is rounded ten thousand times
    "long_list": 2e-5,  # measured 5.4e-6, in depth
}

FAST_BOUND = 0.003
"""Of the default. Measured: at most 8e-4 in any channel and 1.1e-3 in alpha."""
FAST_DEPTH = {
    "far_off_axis": 0.01,  # measured 5e-3: what is cut lies 60 times as far away
    # A thousandth of the light, at 1e8 times the depth, is all of the mean depth.
    "astronomical_and_microscopic": math.inf,
}
ALL_CUT = "ten_thousand_on_one_pixel"
"""The one case that the default cannot draw: thousands that are each below its cut-off."""


def bounds(name: str, preset: str) -> Errors:
    """Return bounds on the errors of a case with the settings ``exact`` or ``fast``."""
    if preset == "exact":
        return Errors(*[LONGER.get(name, EXACT_BOUND)] * 3)
    return Errors(FAST_BOUND, FAST_BOUND, FAST_DEPTH.get(name, FAST_BOUND))


NEAR = Settings().near
Scene = tuple[Gaussians, torch.Tensor, Camera]


@cache
def case(name: str) -> Case:
    """The case of that name."""
    return Case(*CASES[name]())


@cache
def _render_reference(name: str, settings: Settings) -> Render:
    return rasterize(*case(name), backend="reference", settings=settings)


def measure(name: str, settings: str) -> Errors:
    """Errors of the cpu backend with ``settings`` on the case of that name."""
    true = _render_reference(
        name, replace(PRESETS[settings], alpha_min=0.0, sigmas=math.inf, pass_min=0.0)
    )
    fast = rasterize(*case(name), backend="cpu", settings=settings)
    solid = true.alpha > 0.5
    depth = (fast.depth.double() - true.depth)[solid] / true.depth[solid]
    return Errors(_worst(fast.values - true.values), _worst(fast.alpha - true.alpha), _worst(depth))


def _worst(difference: torch.Tensor) -> float:
    """Largest magnitude, 0 of nothing; NaN stays NaN, so that it passes no bound."""
    return float(difference.abs().max()) if difference.numel() else 0.0


# What the cases are made of.


def rotate_randomly(seed: int, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A camera-to-world pose with a random rotation."""
    R, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    c2w = np.eye(4)
    c2w[:3, :3] = R * np.sign(np.linalg.det(R))
    c2w[:3, 3] = centre
    return c2w


def unproject_pixels(view: Camera, u: Any, v: Any, z: Any) -> torch.Tensor:
    """World points float32 [N, 3] that ``view`` shows at pixels (u, v) and depths z."""
    u, v, z = (a.reshape(-1) for a in np.broadcast_arrays(u, v, np.asarray(z, np.float64)))
    local = np.stack([u, v, np.ones_like(z)], -1) @ np.linalg.inv(view.K).T * z[:, None]
    world = local @ view.c2w[:3, :3].T + view.center
    return torch.from_numpy(world.astype(np.float32))


def splats(
    means: Any, scales: Any = 0.1, opacities: Any = 0.8, quats: Any = (1.0, 0.0, 0.0, 0.0)
) -> Gaussians:
    """Gaussians from what is given, each spread over all of them; float64 if the means are."""
    dtype = getattr(means, "dtype", None)
    dtype = torch.float64 if dtype == torch.float64 else torch.float32
    means = torch.as_tensor(means, dtype=dtype).reshape(-1, 3)
    n = len(means)

    def spread(numbers: Any, *shape: int) -> torch.Tensor:
        return torch.as_tensor(numbers, dtype=dtype).expand(*shape).contiguous()

    return Gaussians(
        means=means,
        scales=spread(scales, n, 3),
        quats=spread(quats, n, 4),
        opacities=spread(opacities, n),
        sh=torch.zeros(n, 1, 3, dtype=dtype),
        source=torch.arange(n, dtype=torch.int32),
    )


class _Random:
    """Short names for what most cases draw at random."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> torch.Tensor:
        return torch.rand(*shape, generator=self.generator) * (high - low) + low

    def magnitudes(self, *shape: int, low: float, high: float) -> torch.Tensor:
        return torch.exp(self.uniform(*shape, low=math.log(low), high=math.log(high)))

    def quats(self, n: int) -> torch.Tensor:
        return torch.randn(n, 4, generator=self.generator)

    def inside(self, view: Camera, n: int, low=2.0, high=6.0, margin=0.1) -> torch.Tensor:
        """Points in the image of ``view`` and a little around it."""
        u = self.uniform(n, low=-margin, high=1 + margin).double().numpy() * view.width
        v = self.uniform(n, low=-margin, high=1 + margin).double().numpy() * view.height
        return unproject_pixels(view, u, v, self.magnitudes(n, low=low, high=high).numpy())


def cloud(n: int, seed=0, size=0.3, view=None, channels=5) -> tuple[Gaussians, torch.Tensor]:
    """Gaussians of every shape and opacity before the camera, and values in [0, 1]."""
    r = _Random(seed)
    means = r.inside(camera() if view is None else view, n)
    scales = r.uniform(n, 3, low=0.01, high=0.01 + size)
    return splats(means, scales, r.uniform(n), r.quats(n)), r.uniform(n, channels)


# The cases.


def ordinary_cloud() -> Scene:
    """A hundred Gaussians of every shape; the control."""
    view = camera(48, 32, 40, c2w=rotate_randomly(1, (1.0, -2.0, 0.5)))
    return *cloud(100, 1, 0.2, view), view


def a_gaussian_per_pixel() -> Scene:
    """Return a surface of small opaque discs twice, as two pixel-aligned views predict it."""
    view, r = camera(32, 24, 30), _Random(2)
    u, v = np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5)
    means = [
        unproject_pixels(view, u + shift, v, 3 + 0.5 * np.sin(u / 9) + shift) for shift in (0, 0.3)
    ]
    n = 2 * 32 * 24
    scales = torch.stack([r.uniform(n, low=0.04, high=0.1)] * 2 + [torch.full((n,), 0.005)], -1)
    opacities, quats = r.uniform(n, low=0.5), r.quats(n) * 0.1 + torch.tensor([1.0, 0, 0, 0])
    return splats(torch.cat(means), scales, opacities, quats), r.uniform(n, 6), view


def at_the_near_plane() -> Scene:
    """Centres exactly on the near plane, which are not drawn, and the next float behind it."""
    on = np.float32(NEAR)
    z = [on, np.nextafter(on, np.float32(0)), np.nextafter(on, np.float32(1)), 0.0100001, 2.0]
    output = splats([[0, 0, d] for d in z], 1e-3, 0.7)
    return output, torch.eye(5), camera()


def behind_the_near_plane() -> Scene:
    """Centres behind the camera, in its centre and before the near plane; one is drawn."""
    z = [-3.0, -1e-3, 0.0, 1e-30, 0.005, 0.0099, 3.0]
    return splats([[0.1, 0, d] for d in z], 0.2, 0.9), torch.eye(7), camera()


def reaching_through_the_near_plane() -> Scene:
    """Large Gaussians whose centres lie just behind the near plane."""
    r = _Random(4)
    means = torch.cat(
        [r.uniform(20, 2, low=-0.05, high=0.05), r.uniform(20, 1, low=0.0101, high=0.2)], 1
    )
    output = splats(means, r.magnitudes(20, 3, low=0.01, high=2.0), r.uniform(20), r.quats(20))
    return output, r.uniform(20, 3), camera()


def far_off_axis() -> Scene:
    """Gaussians beside the camera, up to a thousand times as far off the axis as before it."""
    r = _Random(5)
    angle = r.uniform(60, high=2 * math.pi)
    off = r.magnitudes(60, low=0.5, high=1000)
    z = r.magnitudes(60, low=0.05, high=3)
    means = torch.stack([off * z * angle.cos(), off * z * angle.sin(), z], -1)
    output = splats(
        means, (off * z)[:, None] * r.uniform(60, 3, low=0.05), r.uniform(60), r.quats(60)
    )
    return output, r.uniform(60, 3), camera()


def pancakes_on_edge() -> Scene:
    """Large discs seen exactly from the side, at angles that no axis of the image has."""
    view, r = camera(48, 32, 40), _Random(9)
    half = r.uniform(24, high=math.pi)
    quats = torch.stack([half.cos(), 0 * half, 0 * half, half.sin()], -1)
    means = unproject_pixels(view, r.uniform(24).numpy() * 48, r.uniform(24).numpy() * 32, 3.0)
    return splats(means, [1.0, 1e-6, 1.0], r.uniform(24), quats), r.uniform(24, 3), view


def subpixel() -> Scene:
    """A ten-thousandth of a pixel wide, at pixel centres, edges, corners and between."""
    view, r = camera(), _Random(12)
    u = np.concatenate([[4.5, 5.0, 8.0, 8.0, 16.0, 31.999], 32 * r.uniform(60).double().numpy()])
    v = np.concatenate([[4.5, 4.5, 8.0, 16.0, 16.0, 23.999], 24 * r.uniform(60).double().numpy()])
    return (
        splats(unproject_pixels(view, u, v, 3.0), 1e-5, r.uniform(66, low=0.3)),
        r.uniform(66, 3),
        view,
    )


def one_covers_the_image() -> Scene:
    """A single opaque Gaussian of 6000 pixels before everything."""
    r = _Random(13)
    means, scales = [[0.3, -0.2, 5.0], [0, 0, 6.0]], [[1e3] * 3, [1.0] * 3]
    return splats(means, scales, [1.0, 0.9]), r.uniform(2, 3), camera()


def mixed_huge_and_tiny() -> Scene:
    """Specks before, in and behind Gaussians of a hundred images; some of the huge are faint."""
    view, r = camera(48, 32, 40), _Random(14)
    huge = r.uniform(80, 1) < 0.2
    sizes = [r.magnitudes(80, 3, low=low, high=high) for low, high in ((10, 500), (1e-5, 0.05))]
    opacities = torch.where(huge[:, 0], r.uniform(80, high=0.4), r.uniform(80, low=0.5))
    return (
        splats(r.inside(view, 80), torch.where(huge, *sizes), opacities, r.quats(80)),
        r.uniform(80, 3),
        view,
    )


def _with_opacity(opacity: float, seed: int) -> Scene:
    view, r = camera(), _Random(seed)
    opacities = torch.where(r.uniform(40) < 0.5, torch.tensor(opacity), r.uniform(40))
    means, scales = r.inside(view, 40), r.uniform(40, 3, low=0.02, high=0.3)
    return splats(means, scales, opacities, r.quats(40)), r.uniform(40, 3), view


def opaque_right_at_pixel_centres() -> Scene:
    """Opacity 1 with its peak on the pixel: nothing at all is let through to what follows."""
    view, r = camera(), _Random(19)
    u, v = np.meshgrid(np.arange(0, 32, 3) + 0.5, np.arange(0, 24, 3) + 0.5)
    means = torch.cat([unproject_pixels(view, u, v, z) for z in (2.0, 3.0)])
    return splats(means, 0.05, 1.0), r.uniform(len(means), 3), view


def ten_thousand_on_one_pixel() -> Scene:
    """Each under the cut-offs around the middle, and all of them together opaque."""
    r = _Random(20)
    means = torch.zeros(10_000, 3)
    means[:, 2] = torch.linspace(2, 3, 10_000)
    return splats(means, 0.01, 0.002), r.uniform(10_000, 2), camera(31, 23)


def long_list() -> Scene:
    """Four thousand faint layers on every pixel: sums of thousands of small float32 numbers."""
    r = _Random(21)
    means = torch.cat(
        [r.uniform(4000, 2, low=-0.2, high=0.2), r.magnitudes(4000, 1, low=2, high=3)], 1
    )
    return splats(means, 2.0, 0.0015), r.uniform(4000, 3), camera(20, 12)


def equal_depths() -> Scene:
    """All at one depth, overlapping: the order of the input decides."""
    r = _Random(22)
    means = torch.cat([r.uniform(50, 2, low=-1, high=1), torch.full((50, 1), 3.0)], 1)
    return splats(means, 0.5, r.uniform(50)), r.uniform(50, 3), camera()


def depths_a_float_apart() -> Scene:
    """Neighbouring float32 depths, in any order."""
    r = _Random(23)
    steps = torch.randperm(50, generator=r.generator).float() * 2.0**-22
    means = torch.cat([r.uniform(50, 2, low=-1, high=1), 3.0 + steps[:, None]], 1)
    return splats(means, 0.5, r.uniform(50)), r.uniform(50, 3), camera()


def _with_quaternions(low: float, high: float, seed: int) -> Scene:
    """Quaternions of these lengths, whose squares may be beyond float32."""
    view, r = camera(), _Random(seed)
    means, scales = r.inside(view, 60), r.uniform(60, 3, low=0.01, high=0.4)
    output = splats(means, scales, r.uniform(60), r.quats(60))
    output.quats[:] *= r.magnitudes(60, 1, low=low, high=high)
    return output, r.uniform(60, 3), view


def _with_focal(focal: float, seed: int) -> Scene:
    view, r = camera(48, 32, focal, c2w=rotate_randomly(seed)), _Random(seed)
    means = r.inside(view, 80)
    z = torch.from_numpy(view.project(means.double().numpy())[1]).float()
    scales = r.magnitudes(80, 3, low=0.1, high=10) * z[:, None] / focal
    return splats(means, scales, r.uniform(80), r.quats(80)), r.uniform(80, 3), view


def astronomical_and_microscopic() -> Scene:
    """Depths from the near plane to 1e8, each Gaussian a few pixels wide."""
    view, r = wide(30), _Random(30)
    z = r.magnitudes(80, low=0.011, high=1e8)
    means = unproject_pixels(
        view, r.uniform(80).numpy() * 48, r.uniform(80).numpy() * 32, z.numpy()
    )
    scales = r.uniform(80, 3, low=0.01, high=0.2) * z[:, None]
    return splats(means, scales, r.uniform(80), r.quats(80)), r.uniform(80, 3), view


def nothing_in_sight() -> Scene:
    """All beside or behind the camera."""
    r = _Random(31)
    means = torch.cat([r.uniform(30, 2, low=50, high=60), r.uniform(30, 1, low=-5, high=5)], 1)
    return splats(means, 0.1, 0.9), r.uniform(30, 3), camera()


def _with_channels(channels: int, seed: int) -> Scene:
    view = camera()
    output, _ = cloud(40, seed, 0.3, view)
    return output, _Random(seed).uniform(40, channels, low=-1), view


def _random(seed: int, n: int, scales: Any, view: Camera, **inside: float) -> Scene:
    """Gaussians in sight of ``view``, and random but for their ``scales``."""
    r = _Random(seed)
    means = r.inside(view, n, **inside)
    scales = scales(r, n) if callable(scales) else scales
    return splats(means, scales, r.uniform(n), r.quats(n)), r.uniform(n, 3), view


def _uniform(low: float, high: float) -> Callable[[_Random, int], torch.Tensor]:
    return lambda r, n: r.uniform(n, 3, low=low, high=high)


def _cloud(n: int, seed: int, size: float, view: Camera) -> Scene:
    return *cloud(n, seed, size, view, 3), view


def wide(seed: int, **settings: Any) -> Camera:
    return camera(48, 32, settings.pop("focal", 40), c2w=rotate_randomly(seed), **settings)


CASES: dict[str, Callable[[], Scene]] = {
    # 400 large Gaussians on a small image.
    "dense_overlap": lambda: _random(3, 400, _uniform(0.05, 0.6), camera(64, 48, 60)),
    # A million times as long as wide, in all directions; and a hundred images long.
    "needles": lambda: _random(6, 40, [1.0, 1e-6, 1e-6], wide(6)),
    "needles_longer_than_the_scene": lambda: _random(7, 20, [1e-4, 100, 1e-4], camera(48, 32, 40)),
    # A million times as wide as thick, in all directions.
    "pancakes": lambda: _random(8, 40, [1.0, 1.0, 1e-6], wide(8)),
    # Axes from a millionth to a thousand times the scene, mixed in one Gaussian.
    "scales_of_nine_decades": lambda: _random(
        10, 80, lambda r, n: r.magnitudes(n, 3, low=1e-6, high=1e3), wide(10)
    ),
    # Points, line segments and sheets without any thickness.
    "scales_of_zero": lambda: _random(
        11, 40, lambda r, n: r.uniform(n, 3, high=0.3) * (r.uniform(n, 3) < 0.5), camera()
    ),
    "opacity_0": lambda: _with_opacity(0.0, 15),
    "opacity_1": lambda: _with_opacity(1.0, 16),
    "opacity_almost_1": lambda: _with_opacity(1 - 1e-7, 17),
    "quaternions_of_any_length": lambda: _with_quaternions(1e-36, 1e36, 24),
    "quaternions_near_zero": lambda: _with_quaternions(1e-20, 1e-20, 25),
    "focal_2": lambda: _with_focal(2.0, 26),  # a field of view of 170 degrees
    "focal_50000": lambda: _with_focal(50_000.0, 28),  # of three minutes of arc
    # Camera and scene a million units from the origin, where float32 places are 0.06 apart.
    "a_million_units_away": lambda: _random(
        29, 80, _uniform(0.05, 2),
        camera(48, 32, 40, c2w=rotate_randomly(29, (1e6, -1e6, 1e6))), low=8, high=24,
    ),
    "nothing": lambda: (splats(torch.zeros(0, 3)), torch.zeros(0, 3), camera()),
    "image_of_1x1": lambda: _cloud(60, 32, 0.5, camera(1, 1, 1, c2w=rotate_randomly(32))),
    # A pixel more than tiles of 8 to 32.
    "image_of_17x33": lambda: _cloud(60, 34, 0.5, camera(17, 33, 33, c2w=rotate_randomly(34))),
    # A window cut from far off the middle of a large image.
    "principal_point_far_outside": lambda: _cloud(80, 36, 0.5, wide(36, focal=60, cx=-400, cy=300)),
    # Rows shifted by a third of a pixel each, and the far corner off-axis.
    "skewed_pixels": lambda: _cloud(80, 38, 0.3, wide(38, focal=60, skew=20.0, cx=10)),
    # Ten times as wide as high.
    "pixels_that_are_not_square": lambda: _cloud(80, 39, 0.2, wide(39, focal=20, aspect=10.0)),
    # A rotation that is one only to a thousandth, as in files that print few digits.
    "a_pose_of_three_digits": lambda: _cloud(
        80, 40, 0.3, camera(48, 32, 40, c2w=rotate_randomly(40).round(4))
    ),
    "no_channel": lambda: _with_channels(0, 41),
    "seven_channels": lambda: _with_channels(7, 43),  # no multiple of what is summed at once
    "three_hundred_channels": lambda: _with_channels(300, 44),
    **{
        make.__name__: make
        for make in (
            ordinary_cloud, a_gaussian_per_pixel, at_the_near_plane, behind_the_near_plane,
            reaching_through_the_near_plane, far_off_axis, pancakes_on_edge, subpixel,
            one_covers_the_image, mixed_huge_and_tiny, opaque_right_at_pixel_centres,
            ten_thousand_on_one_pixel, long_list, equal_depths, depths_a_float_apart,
            astronomical_and_microscopic, nothing_in_sight,
        )
    },
}  # fmt: skip
