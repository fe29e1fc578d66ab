"""Scenes that are hard to rasterize, and the error of the cpu backend on each."""

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


class Case(NamedTuple):
    """One scene and the camera that renders it."""

    gaussians: Gaussians
    values: torch.Tensor
    camera: Camera


class Errors(NamedTuple):
    """Largest differences from the reference: absolute for values and alpha.

    ``depth`` is relative, where alpha is above one half: below it, the Gaussians that a cut-off
    drops decide the mean depth.
    """

    values: float
    alpha: float
    depth: float


EXACT_BOUND = 5e-6
"""Bound without cut-offs. Measured: at most 3.7e-6 in any channel, in alpha and in relative depth,
most cases 5e-7; float32 sums are good for 1e-7 a number."""
LOOSER_EXACT_BOUNDS = {
    "ten_thousand_on_one_pixel": 1e-4,  # measured 6.2e-5: 1 - alpha is rounded ten thousand times
    "long_list": 2e-5,  # measured 5.4e-6, in depth
}

FAST_BOUND = 0.003
"""Bound of the default. Measured: at most 8e-4 in any channel and 1.1e-3 in alpha."""
FAST_DEPTH_BOUNDS = {
    "far_off_axis": 0.01,  # measured 5e-3: dropped Gaussians are 60 times as far away
    # A thousandth of the light, at 1e8 times the depth, is all of the mean depth.
    "astronomical_and_microscopic": math.inf,
}
ALL_CUT = "ten_thousand_on_one_pixel"
"""The one case that the default cannot render: every Gaussian is below its cut-off."""


def error_bounds(name: str, preset: str) -> Errors:
    """Return the bounds on the errors of a case with the settings ``exact`` or ``fast``."""
    if preset == "exact":
        return Errors(*[LOOSER_EXACT_BOUNDS.get(name, EXACT_BOUND)] * 3)
    return Errors(FAST_BOUND, FAST_BOUND, FAST_DEPTH_BOUNDS.get(name, FAST_BOUND))


NEAR = Settings().near
Scene = tuple[Gaussians, torch.Tensor, Camera]


@cache
def make_case(name: str) -> Case:
    return Case(*CASES[name]())


@cache
def _render_reference(name: str, settings: Settings) -> Render:
    return rasterize(*make_case(name), backend="reference", settings=settings)


def measure_errors(name: str, preset: str) -> Errors:
    """Return the errors of the cpu backend with the settings ``preset`` on a case."""
    no_cutoffs = replace(PRESETS[preset], alpha_min=0.0, sigmas=math.inf, pass_min=0.0)
    expected = _render_reference(name, no_cutoffs)
    actual = rasterize(*make_case(name), backend="cpu", settings=preset)
    solid = expected.alpha > 0.5
    depth = (actual.depth.double() - expected.depth)[solid] / expected.depth[solid]
    differences = actual.values - expected.values, actual.alpha - expected.alpha, depth
    # An empty tensor has no error; NaN stays NaN, so that it passes no bound.
    return Errors(*(float(d.abs().max()) if d.numel() else 0.0 for d in differences))


# Parts of the cases.


def make_camera(
    width=32, height=24, focal=30.0, cx=None, cy=None, skew=0.0, c2w=None, aspect=1.0
) -> Camera:
    """Return a small camera at the origin that looks along z; ``aspect`` is a pixel's height."""
    cx, cy = width / 2 if cx is None else cx, height / 2 if cy is None else cy
    K = np.array([[focal, skew, cx], [0, focal * aspect, cy], [0, 0, 1]])
    return Camera(K, np.eye(4) if c2w is None else c2w, width, height)


def random_pose(seed: int, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return a camera-to-world pose with a random rotation."""
    R, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    c2w = np.eye(4)
    c2w[:3, :3] = R * np.sign(np.linalg.det(R))
    c2w[:3, 3] = centre
    return c2w


def unproject_pixels(camera: Camera, u: Any, v: Any, z: Any) -> torch.Tensor:
    """Return world points float32 [N, 3] at pixels (u, v) of ``camera`` and depths z."""
    u, v, z = (a.reshape(-1) for a in np.broadcast_arrays(u, v, np.asarray(z, np.float64)))
    local = np.stack([u, v, np.ones_like(z)], -1) @ np.linalg.inv(camera.K).T * z[:, None]
    world = local @ camera.c2w[:3, :3].T + camera.center
    return torch.from_numpy(world.astype(np.float32))


def splats(
    means: Any, scales: Any = 0.1, opacities: Any = 0.8, quats: Any = (1.0, 0.0, 0.0, 0.0)
) -> Gaussians:
    """Return Gaussians at ``means``; every other argument is broadcast to all of them."""
    means = torch.as_tensor(means, dtype=torch.float32).reshape(-1, 3)
    n = len(means)

    def broadcast(numbers: Any, *shape: int) -> torch.Tensor:
        return torch.as_tensor(numbers, dtype=torch.float32).expand(*shape).contiguous()

    return Gaussians(
        means=means,
        scales=broadcast(scales, n, 3),
        quats=broadcast(quats, n, 4),
        opacities=broadcast(opacities, n),
        sh=torch.zeros(n, 1, 3),
        source=torch.arange(n, dtype=torch.int32),
    )


class _Random:
    """Distributions from which most cases are drawn."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> torch.Tensor:
        return torch.rand(*shape, generator=self.generator) * (high - low) + low

    def log_uniform(self, *shape: int, low: float, high: float) -> torch.Tensor:
        return torch.exp(self.uniform(*shape, low=math.log(low), high=math.log(high)))

    def quats(self, n: int) -> torch.Tensor:
        return torch.randn(n, 4, generator=self.generator)

    def means(self, camera: Camera, n: int, low=2.0, high=6.0) -> torch.Tensor:
        """Return points in the image of ``camera`` and up to a tenth of it outside."""
        u = self.uniform(n, low=-0.1, high=1.1).double().numpy() * camera.width
        v = self.uniform(n, low=-0.1, high=1.1).double().numpy() * camera.height
        return unproject_pixels(camera, u, v, self.log_uniform(n, low=low, high=high).numpy())


def random_gaussians(
    n: int, seed=0, size=0.3, camera=None, channels=5
) -> tuple[Gaussians, torch.Tensor]:
    """Return Gaussians of all shapes and opacities before the camera, and values in [0, 1]."""
    rng = _Random(seed)
    means = rng.means(make_camera() if camera is None else camera, n)
    scales = rng.uniform(n, 3, low=0.01, high=0.01 + size)
    return splats(means, scales, rng.uniform(n), rng.quats(n)), rng.uniform(n, channels)


# The cases.


def ordinary_cloud() -> Scene:
    """A hundred Gaussians of all shapes; the control."""
    camera = make_camera(48, 32, 40, c2w=random_pose(1, (1.0, -2.0, 0.5)))
    return *random_gaussians(100, 1, 0.2, camera), camera


def one_gaussian_per_pixel() -> Scene:
    """Pixel-aligned Gaussians of two views: a surface of small opaque discs, twice."""
    camera, rng = make_camera(32, 24, 30), _Random(2)
    u, v = np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5)
    z = 3 + 0.5 * np.sin(u / 9)
    means = [unproject_pixels(camera, u + shift, v, z + shift) for shift in (0, 0.3)]
    n = 2 * 32 * 24
    scales = torch.stack([rng.uniform(n, low=0.04, high=0.1)] * 2 + [torch.full((n,), 0.005)], -1)
    opacities, quats = rng.uniform(n, low=0.5), rng.quats(n) * 0.1 + torch.tensor([1.0, 0, 0, 0])
    return splats(torch.cat(means), scales, opacities, quats), rng.uniform(n, 6), camera


def at_the_near_plane() -> Scene:
    """Centres exactly on the near plane, which are not drawn, and the next float behind it."""
    near = np.float32(NEAR)
    z = [near, np.nextafter(near, np.float32(0)), np.nextafter(near, np.float32(1)), 0.0100001, 2.0]
    return splats([[0, 0, depth] for depth in z], 1e-3, 0.7), torch.eye(5), make_camera()


def behind_the_near_plane() -> Scene:
    """Centres behind the camera, in its centre and before the near plane; one is drawn."""
    z = [-3.0, -1e-3, 0.0, 1e-30, 0.005, 0.0099, 3.0]
    return splats([[0.1, 0, depth] for depth in z], 0.2, 0.9), torch.eye(7), make_camera()


def crossing_the_near_plane() -> Scene:
    """Large Gaussians whose centres lie just behind the near plane."""
    rng = _Random(4)
    xy, z = rng.uniform(20, 2, low=-0.05, high=0.05), rng.uniform(20, 1, low=0.0101, high=0.2)
    scales = rng.log_uniform(20, 3, low=0.01, high=2.0)
    gaussians = splats(torch.cat([xy, z], 1), scales, rng.uniform(20), rng.quats(20))
    return gaussians, rng.uniform(20, 3), make_camera()


def far_off_axis() -> Scene:
    """Gaussians beside the camera, up to a thousand times as far off the axis as before it."""
    rng = _Random(5)
    angle = rng.uniform(60, high=2 * math.pi)
    ratio = rng.log_uniform(60, low=0.5, high=1000)
    z = rng.log_uniform(60, low=0.05, high=3)
    means = torch.stack([ratio * z * angle.cos(), ratio * z * angle.sin(), z], -1)
    scales = (ratio * z)[:, None] * rng.uniform(60, 3, low=0.05)
    gaussians = splats(means, scales, rng.uniform(60), rng.quats(60))
    return gaussians, rng.uniform(60, 3), make_camera()


def pancakes_on_edge() -> Scene:
    """Large discs seen exactly edge-on, at angles oblique to the image axes."""
    camera, rng = make_camera(48, 32, 40), _Random(9)
    half = rng.uniform(24, high=math.pi)
    quats = torch.stack([half.cos(), 0 * half, 0 * half, half.sin()], -1)
    u, v = rng.uniform(24).numpy() * 48, rng.uniform(24).numpy() * 32
    means = unproject_pixels(camera, u, v, 3.0)
    return splats(means, [1.0, 1e-6, 1.0], rng.uniform(24), quats), rng.uniform(24, 3), camera


def subpixel() -> Scene:
    """A ten-thousandth of a pixel wide, at pixel centres, edges, corners and between."""
    camera, rng = make_camera(), _Random(12)
    u = np.concatenate([[4.5, 5, 8, 8, 16, 31.999], 32 * rng.uniform(60).double().numpy()])
    v = np.concatenate([[4.5, 4.5, 8, 16, 16, 23.999], 24 * rng.uniform(60).double().numpy()])
    means = unproject_pixels(camera, u, v, 3.0)
    return splats(means, 1e-5, rng.uniform(66, low=0.3)), rng.uniform(66, 3), camera


def image_covering_gaussian() -> Scene:
    """A single opaque Gaussian 6000 pixels wide in front of a smaller one."""
    means, scales = [[0.3, -0.2, 5.0], [0, 0, 6.0]], [[1e3] * 3, [1.0] * 3]
    return splats(means, scales, [1.0, 0.9]), _Random(13).uniform(2, 3), make_camera()


def mixed_huge_and_tiny() -> Scene:
    """Specks before, in and behind Gaussians of a hundred images; some of the huge are faint."""
    camera, rng = make_camera(48, 32, 40), _Random(14)
    huge = rng.uniform(80, 1) < 0.2
    sizes = [rng.log_uniform(80, 3, low=low, high=high) for low, high in ((10, 500), (1e-5, 0.05))]
    opacities = torch.where(huge[:, 0], rng.uniform(80, high=0.4), rng.uniform(80, low=0.5))
    means, scales = rng.means(camera, 80), torch.where(huge, *sizes)
    return splats(means, scales, opacities, rng.quats(80)), rng.uniform(80, 3), camera


def _with_opacity(opacity: float, seed: int) -> Scene:
    camera, rng = make_camera(), _Random(seed)
    opacities = torch.where(rng.uniform(40) < 0.5, torch.tensor(opacity), rng.uniform(40))
    means, scales = rng.means(camera, 40), rng.uniform(40, 3, low=0.02, high=0.3)
    return splats(means, scales, opacities, rng.quats(40)), rng.uniform(40, 3), camera


def opaque_at_pixel_centres() -> Scene:
    """Opacity 1 with its peak on the pixel: the Gaussians behind it get no light at all."""
    camera, rng = make_camera(), _Random(19)
    u, v = np.meshgrid(np.arange(0, 32, 3) + 0.5, np.arange(0, 24, 3) + 0.5)
    means = torch.cat([unproject_pixels(camera, u, v, z) for z in (2.0, 3.0)])
    return splats(means, 0.05, 1.0), rng.uniform(len(means), 3), camera


def ten_thousand_on_one_pixel() -> Scene:
    """Each under the cut-offs around the middle, and all of them together opaque."""
    means = torch.zeros(10_000, 3)
    means[:, 2] = torch.linspace(2, 3, 10_000)
    return splats(means, 0.01, 0.002), _Random(20).uniform(10_000, 2), make_camera(31, 23)


def long_list() -> Scene:
    """Four thousand faint layers on every pixel: sums of thousands of small float32 numbers."""
    rng = _Random(21)
    xy, z = rng.uniform(4000, 2, low=-0.2, high=0.2), rng.log_uniform(4000, 1, low=2, high=3)
    return splats(torch.cat([xy, z], 1), 2.0, 0.0015), rng.uniform(4000, 3), make_camera(20, 12)


def _with_depth_steps(step: float, seed: int) -> Scene:
    """Overlapping Gaussians at depths ``step`` apart, in random order."""
    rng = _Random(seed)
    z = 3.0 + torch.randperm(50, generator=rng.generator)[:, None] * step
    means = torch.cat([rng.uniform(50, 2, low=-1, high=1), z], 1)
    return splats(means, 0.5, rng.uniform(50)), rng.uniform(50, 3), make_camera()


def _with_quaternions(low: float, high: float, seed: int) -> Scene:
    """Quaternions of these lengths, whose squares may be beyond float32."""
    camera, rng = make_camera(), _Random(seed)
    means, scales = rng.means(camera, 60), rng.uniform(60, 3, low=0.01, high=0.4)
    gaussians = splats(means, scales, rng.uniform(60), rng.quats(60))
    gaussians.quats[:] *= rng.log_uniform(60, 1, low=low, high=high)
    return gaussians, rng.uniform(60, 3), camera


def _with_focal(focal: float, seed: int) -> Scene:
    camera, rng = make_camera(48, 32, focal, c2w=random_pose(seed)), _Random(seed)
    means = rng.means(camera, 80)
    z = torch.from_numpy(camera.project(means.double().numpy())[1]).float()
    scales = rng.log_uniform(80, 3, low=0.1, high=10) * z[:, None] / focal
    return splats(means, scales, rng.uniform(80), rng.quats(80)), rng.uniform(80, 3), camera


def astronomical_and_microscopic() -> Scene:
    """Depths from the near plane to 1e8, each Gaussian a few pixels wide."""
    camera, rng = turned_camera(30), _Random(30)
    z = rng.log_uniform(80, low=0.011, high=1e8)
    u, v = rng.uniform(80).numpy() * 48, rng.uniform(80).numpy() * 32
    means = unproject_pixels(camera, u, v, z.numpy())
    scales = rng.uniform(80, 3, low=0.01, high=0.2) * z[:, None]
    return splats(means, scales, rng.uniform(80), rng.quats(80)), rng.uniform(80, 3), camera


def all_out_of_view() -> Scene:
    """Gaussians beside or behind the camera."""
    rng = _Random(31)
    xy, z = rng.uniform(30, 2, low=50, high=60), rng.uniform(30, 1, low=-5, high=5)
    return splats(torch.cat([xy, z], 1), 0.1, 0.9), rng.uniform(30, 3), make_camera()


def _with_channels(channels: int, seed: int) -> Scene:
    gaussians, _ = random_gaussians(40, seed)
    return gaussians, _Random(seed).uniform(40, channels, low=-1), make_camera()


def _with_scales(seed: int, n: int, scales: Any, camera: Camera, **depths: float) -> Scene:
    """Gaussians in view of ``camera``, random but for their ``scales``."""
    rng = _Random(seed)
    means = rng.means(camera, n, **depths)
    scales = scales(rng, n) if callable(scales) else scales
    return splats(means, scales, rng.uniform(n), rng.quats(n)), rng.uniform(n, 3), camera


def _uniform(low: float, high: float) -> Callable[[_Random, int], torch.Tensor]:
    return lambda rng, n: rng.uniform(n, 3, low=low, high=high)


def _with_camera(n: int, seed: int, size: float, camera: Camera) -> Scene:
    return *random_gaussians(n, seed, size, camera, 3), camera


def turned_camera(seed: int, focal: float = 40, **intrinsics: Any) -> Camera:
    return make_camera(48, 32, focal, c2w=random_pose(seed), **intrinsics)


CASES: dict[str, Callable[[], Scene]] = {
    # 400 large Gaussians on a small image.
    "dense_overlap": lambda: _with_scales(3, 400, _uniform(0.05, 0.6), make_camera(64, 48, 60)),
    # A million times as long as wide, in all directions; and a hundred images long.
    "needles": lambda: _with_scales(6, 40, [1.0, 1e-6, 1e-6], turned_camera(6)),
    "needles_longer_than_the_scene": lambda: _with_scales(
        7, 20, [1e-4, 100, 1e-4], make_camera(48, 32, 40)
    ),
    # A million times as wide as thick, in all directions.
    "pancakes": lambda: _with_scales(8, 40, [1.0, 1.0, 1e-6], turned_camera(8)),
    # Axes from a millionth to a thousand times the scene, mixed in one Gaussian.
    "scales_of_nine_decades": lambda: _with_scales(
        10, 80, lambda rng, n: rng.log_uniform(n, 3, low=1e-6, high=1e3), turned_camera(10)
    ),
    # Points, line segments and sheets without any thickness.
    "scales_of_zero": lambda: _with_scales(
        11, 40, lambda rng, n: rng.uniform(n, 3, high=0.3) * (rng.uniform(n, 3) < 0.5),
        make_camera(),
    ),
    "opacity_0": lambda: _with_opacity(0.0, 15),
    "opacity_1": lambda: _with_opacity(1.0, 16),
    "opacity_almost_1": lambda: _with_opacity(1 - 1e-7, 17),
    "equal_depths": lambda: _with_depth_steps(0.0, 22),  # the order of the input decides
    "adjacent_float32_depths": lambda: _with_depth_steps(2.0**-22, 23),
    "quaternions_of_any_length": lambda: _with_quaternions(1e-36, 1e36, 24),
    "quaternions_near_zero": lambda: _with_quaternions(1e-20, 1e-20, 25),
    "focal_2": lambda: _with_focal(2.0, 26),  # a field of view of 170 degrees
    "focal_50000": lambda: _with_focal(50_000.0, 28),  # of three minutes of arc
    # Camera and scene a million units from the origin, where float32 positions are 0.06 apart.
    "a_million_units_away": lambda: _with_scales(
        29, 80, _uniform(0.05, 2),
        make_camera(48, 32, 40, c2w=random_pose(29, (1e6, -1e6, 1e6))), low=8, high=24,
    ),
    "no_gaussians": lambda: (splats(torch.zeros(0, 3)), torch.zeros(0, 3), make_camera()),
    "image_of_1x1": lambda: _with_camera(60, 32, 0.5, make_camera(1, 1, 1, c2w=random_pose(32))),
    # A pixel more than tiles of 8 to 32.
    "image_of_17x33": lambda: _with_camera(
        60, 34, 0.5, make_camera(17, 33, 33, c2w=random_pose(34))
    ),
    # A window cut from far off the middle of a large image.
    "principal_point_far_outside": lambda: _with_camera(
        80, 36, 0.5, turned_camera(36, focal=60, cx=-400, cy=300)
    ),
    # Rows shifted by a third of a pixel each, and the far corner off-axis.
    "skewed_pixels": lambda: _with_camera(80, 38, 0.3, turned_camera(38, focal=60, skew=20, cx=10)),
    # Ten times as wide as high.
    "non_square_pixels": lambda: _with_camera(80, 39, 0.2, turned_camera(39, focal=20, aspect=10)),
    # A rotation matrix rounded as in files that print few digits.
    "rounded_pose": lambda: _with_camera(
        80, 40, 0.3, make_camera(48, 32, 40, c2w=random_pose(40).round(4))
    ),
    "no_channel": lambda: _with_channels(0, 41),
    "seven_channels": lambda: _with_channels(7, 43),  # not a multiple of the vector width
    "three_hundred_channels": lambda: _with_channels(300, 44),
    **{
        scene.__name__: scene
        for scene in (
            ordinary_cloud, one_gaussian_per_pixel, at_the_near_plane, behind_the_near_plane,
            crossing_the_near_plane, far_off_axis, pancakes_on_edge, subpixel,
            image_covering_gaussian, mixed_huge_and_tiny, opaque_at_pixel_centres,
            ten_thousand_on_one_pixel, long_list, astronomical_and_microscopic, all_out_of_view,
        )
    },
}  # fmt: skip
