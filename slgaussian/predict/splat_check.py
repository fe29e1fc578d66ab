"""Check that a splat and cameras share one world, by renderings beside the photographs.

The measure is the correlation of fine detail: of what remains of the brightness of both pictures,
shrunk to :data:`SIDE` pixels, after a blur is subtracted. It ignores exposure and tint. Two scenes
have no detail in common, while their areas of light and dark may be similar: after a fit of exposure
a wrong scene reaches 24 dB, and a right one may have 17.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.labels import MIN_WEIGHT
from slgaussian.rasterize.picture import compute_view_colours, picture
from slgaussian.scene import Camera, View

SIDE = 120
"""Shorter side of the pictures of which details are compared, pixels."""

DETAIL_STD = 4.0
"""Standard deviation of the subtracted blur, pixels."""

MIN_DETAIL = 0.35
"""Correlation below which splat and cameras are two worlds, see `docs/measured/splats.md`."""

SURE_DETAIL = 0.8
MIN_GAIN = 0.1
"""Below the first correlation, other readings of axes and units are tried, and one that is better
by the second is reported."""

MIN_COVER = 0.05
"""Share of the pixels at which a splat must show anything."""

MIN_TRIED_COVER = 0.3
"""The same of another reading of axes and units."""

EDGE = np.ones((5, 5), np.uint8)
"""Neighbourhood of a compared pixel that must show Gaussians."""

SCALES = (1e-3, 1e-2, 1e2, 1e3, *(1.2**power for power in range(-14, 15) if power))
"""Tried ratios of the units of the splat and the cameras: millimetres, and any up to a dozen."""

TRIED_VIEWS = 3
"""Number of views with which other readings are tried."""


class Agreement(NamedTuple):
    """Agreement of the renderings of a splat with photographs, pooled over all views.

    Attributes:
        cover: Share of the pixels at which the splat shows anything.
        detail: Correlation of fine detail there, -1 to 1.
        psnr: Peak signal-to-noise ratio there, dB, after a gain and an offset for each channel of
            each view.
    """

    cover: float
    detail: float
    psnr: float


def compare(gaussians: Gaussians, photographs: Sequence[tuple[Camera, np.ndarray]]) -> Agreement:
    """Compare a splat with photographs float32 [H, W, 3], 0 to 1, and their cameras."""
    shown, pixels, squares = 0, 0, 0.0
    products = np.zeros(3)  # of the details of both: p q, p p, q q
    for camera, image in photographs:
        drawn = picture(gaussians, compute_view_colours(gaussians, camera), camera, "3dgs")
        covered = drawn.alpha >= MIN_WEIGHT
        shown, pixels = shown + int(covered.sum()), pixels + covered.size
        rgb = drawn.values / np.maximum(drawn.alpha, np.float32(MIN_WEIGHT))[..., None]
        for channel in range(3):
            x, y = rgb[covered, channel].astype(np.float64), image[covered, channel]
            if len(x):
                gain = max(0.0, float(np.mean((x - x.mean()) * y)) / max(float(x.var()), 1e-12))
                squares += float(np.square(y - y.mean() - gain * (x - x.mean())).sum())
        covered, rgb, image = (_shrink(each) for each in (covered.astype(np.float32), rgb, image))
        inner = cv2.erode((covered == 1).astype(np.uint8), EDGE) > 0
        p, q = (_detail(each)[inner] for each in (rgb, image))
        products += p @ q, p @ p, q @ q
    detail = float(products[0] / max(np.sqrt(products[1] * products[2]), 1e-12))
    psnr = -10 * np.log10(max(squares / max(3 * shown, 1), 1e-10)) if shown else 0.0
    return Agreement(shown / pixels, detail, float(psnr))


def _detail(image: np.ndarray) -> np.ndarray:
    grey = image.mean(2)
    detail: np.ndarray = (grey - cv2.GaussianBlur(grey, (0, 0), DETAIL_STD)).astype(np.float64)
    return detail


def check_world(gaussians: Gaussians, views: Sequence[View], trusted: bool = False) -> Agreement:
    """Compare a splat with the photographs of views.

    Raises:
        InputError: If they do not show the same, unless the cameras are ``trusted``; the message
            names the axes or the unit that would explain it, if one does.
    """
    photographs = [(view.camera, view.image.astype(np.float32) / 255) for view in views]
    found = compare(gaussians, photographs)
    if trusted or (found.cover >= MIN_COVER and found.detail >= SURE_DETAIL):
        return found
    some = [
        (camera.resize(small.shape[1], small.shape[0]), small)
        for camera, image in photographs[:: -(-len(photographs) // TRIED_VIEWS)]
        for small in [_shrink(image)]
    ]
    before = compare(gaussians, some).detail
    tried = [(compare(*reading), name) for name, *reading in _readings(gaussians, some)]
    # Where next to nothing is compared, anything may correlate.
    best, name = max((each.detail * (each.cover >= MIN_TRIED_COVER), name) for each, name in tried)
    explained = best >= MIN_DETAIL and best >= before + MIN_GAIN
    if found.cover >= MIN_COVER and found.detail >= MIN_DETAIL and not explained:
        return found
    if found.cover < MIN_COVER:
        what = f"it covers {found.cover:.0%} of what they show"
    else:
        what = f"it has {max(found.detail, 0):.0%} of the detail of the photographs there"
    if explained:
        advice = f"{name} it would have {best:.0%}: write one of the two again in the other's world"
    else:
        advice = f"expected {MIN_DETAIL:.0%} or more: give the cameras by which it was trained"
    raise InputError(f"the splat and the cameras are two worlds: {what}, and {advice}")


def _shrink(image: np.ndarray) -> np.ndarray:
    """Return an image float32 [H, W, ...] with a shorter side of :data:`SIDE` pixels, if longer."""
    height, width = image.shape[:2]
    scale = min(1.0, SIDE / min(height, width))
    size = round(width * scale), round(height * scale)
    small: np.ndarray = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return small


def _readings(
    gaussians: Gaussians, photographs: Sequence[tuple[Camera, np.ndarray]]
) -> Iterator[tuple[str, Gaussians, list[tuple[Camera, np.ndarray]]]]:
    """Yield other readings of axes and units: a description, the splat, and the photographs."""

    def move(change: np.ndarray, own: bool = False) -> list[tuple[Camera, np.ndarray]]:
        return [
            (replace(camera, c2w=camera.c2w @ change if own else change @ camera.c2w), image)
            for camera, image in photographs
        ]

    flip, quarter = np.diag([1.0, -1, -1, 1]), np.eye(4)[[0, 2, 1, 3]] * [[1], [1], [-1], [1]]
    yield "with y and z of each camera's own axes reversed (OpenGL)", gaussians, move(flip, True)
    yield "with y and z of the cameras' world reversed", gaussians, move(flip)
    yield "with the cameras' world turned from z up to y up", gaussians, move(quarter)
    yield "with the cameras' world turned from y up to z up", gaussians, move(quarter.T)
    for axis, letter in enumerate("xyz"):
        arrays = gaussians.to_arrays()
        means, quats = arrays["means"].copy(), arrays["quats"].copy()
        means[:, axis] *= -1
        quats[:, [1 + other for other in range(3) if other != axis]] *= -1
        mirrored = gaussians.with_arrays(means=means, quats=quats)
        yield f"with {letter} of the splat reversed, so that it is mirrored,", mirrored, move(np.eye(4))
    for scale in SCALES:
        moved = []
        for camera, image in photographs:
            c2w = camera.c2w.copy()
            c2w[:3, 3] *= scale
            moved.append((replace(camera, c2w=c2w), image))
        yield f"with the positions of the cameras times {scale:.3g}", gaussians, moved
