"""Check that a splat and cameras share one world, by renderings beside the photographs.

The measure is the correlation of fine detail: of what remains of the brightness of both pictures,
shrunk to :data:`SIDE` pixels, after a blur is subtracted. It ignores exposure and tint. Two scenes
have no detail in common, while their areas of light and dark may be similar: after a fit of
exposure a wrong scene reaches 24 dB, and a right one may have 17.
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
from slgaussian.rasterize.render_settings import find_settings
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

EDGE = np.ones((5, 5), np.uint8)
"""Neighbourhood of a compared pixel that must show Gaussians."""

SCALES = (1e-3, 1e-2, 1e2, 1e3, *(1.08**power for power in range(-30, 31) if power))
"""Tried ratios of the units of the splat and the cameras: any up to 10, and powers of ten."""

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

    @property
    def share(self) -> float:
        """Return the correlation with nothing where the splat shows nothing: a floor at height 0
        stays where it is in a mirrored world."""
        return self.cover * self.detail


class Photograph(NamedTuple):
    """A photograph to compare with.

    Attributes:
        image: float32 [H, W, 3], 0 to 1.
        shrunk: Its size as a share of that of the file. The filter of the image formation is as
            many pixels of the file, or small Gaussians would grow over their neighbours.
    """

    camera: Camera
    image: np.ndarray
    shrunk: float = 1.0

    @staticmethod
    def of(view: View) -> Photograph:
        """Convert a view."""
        part, width = view.visible_window, view.camera.width
        shrunk = min(1.0, width / (part.right - part.left))
        return Photograph(view.camera, view.image.astype(np.float32) / 255, shrunk)

    def shrink(self) -> Photograph:
        """Return it with a shorter side of at most :data:`SIDE` pixels."""
        image = _shrink(self.image)
        height, width = image.shape[:2]
        shrunk = self.shrunk * width / self.camera.width
        return Photograph(self.camera.resize(width, height), image, shrunk)

    def move(self, c2w: np.ndarray) -> Photograph:
        """Return it with another pose of the camera."""
        return self._replace(camera=replace(self.camera, c2w=c2w))


def compare(gaussians: Gaussians, photographs: Sequence[Photograph]) -> Agreement:
    """Compare a splat with photographs."""
    shown, pixels, squares = 0, 0, 0.0
    products = np.zeros(3)  # of the details of both: p q, p p, q q
    for camera, image, shrunk in photographs:
        settings = find_settings("3dgs", gaussians.reach(camera))
        settings = replace(settings, low_pass=settings.low_pass * shrunk**2)
        drawn = picture(gaussians, compute_view_colours(gaussians, camera), camera, settings)
        covered = drawn.alpha >= MIN_WEIGHT
        shown, pixels = shown + int(covered.sum()), pixels + covered.size
        rgb = drawn.values
        for channel in range(3):
            x, y = rgb[covered, channel].astype(np.float64), image[covered, channel]
            if len(x):
                gain = max(0.0, float(np.mean((x - x.mean()) * y)) / max(float(x.var()), 1e-12))
                squares += float(np.square(y - y.mean() - gain * (x - x.mean())).sum())
        covered, rgb, image = (_shrink(each) for each in (covered.astype(np.float32), rgb, image))
        inner = cv2.erode((covered > 0.99).astype(np.uint8), EDGE) > 0
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
    photographs = [Photograph.of(view) for view in views]
    agreement = compare(gaussians, photographs)
    if trusted or (agreement.cover >= MIN_COVER and agreement.detail >= SURE_DETAIL):
        return agreement
    some = [each.shrink() for each in photographs[:: -(-len(photographs) // TRIED_VIEWS)]]
    before = compare(gaussians, some).share
    readings = _readings(gaussians, some)
    best, name = max((compare(splat, moved).share, name) for name, splat, moved in readings)
    explained = best >= MIN_DETAIL and best >= before + MIN_GAIN
    if agreement.cover >= MIN_COVER and agreement.detail >= MIN_DETAIL and not explained:
        return agreement
    if agreement.cover < MIN_COVER:
        what = f"it covers {agreement.cover:.0%} of what they show"
    else:
        what = f"it has {max(agreement.detail, 0):.0%} of the detail of the photographs there"
    if explained:
        advice = (
            f"and {name} it would have {best:.0%}: write one of the two again in the other's world"
        )
    else:
        advice = f"expected {MIN_DETAIL:.0%} or more: give the cameras by which it was trained"
    raise InputError(f"the splat and the cameras are two worlds: {what}, {advice}")


def _shrink(image: np.ndarray) -> np.ndarray:
    """Return an image float32 [H, W, ...] with a shorter side of :data:`SIDE` pixels, if longer."""
    height, width = image.shape[:2]
    scale = min(1.0, SIDE / min(height, width))
    size = round(width * scale), round(height * scale)
    small: np.ndarray = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return small


def _readings(
    gaussians: Gaussians, photographs: Sequence[Photograph]
) -> Iterator[tuple[str, Gaussians, list[Photograph]]]:
    """Yield other readings of axes and units: a description, the splat, and the photographs."""
    flip, quarter = np.diag([1.0, -1, -1, 1]), np.eye(4)[[0, 2, 1, 3]] * [[1], [1], [-1], [1]]
    reading = "with y and z of each camera's own axes reversed (OpenGL)"
    yield reading, gaussians, [each.move(each.camera.c2w @ flip) for each in photographs]
    for turn, name in (
        (flip, "with y and z of the cameras' world reversed"),
        (quarter, "with the cameras' world turned from z up to y up"),
        (quarter.T, "with the cameras' world turned from y up to z up"),
    ):
        yield name, gaussians, [each.move(turn @ each.camera.c2w) for each in photographs]
    arrays = gaussians.to_arrays()
    for axis, letter in enumerate("xyz"):
        means, quats = arrays["means"].copy(), arrays["quats"].copy()
        means[:, axis] *= -1
        quats[:, [1 + other for other in range(3) if other != axis]] *= -1
        mirrored = gaussians.with_arrays(means=means, quats=quats)
        yield (
            f"with {letter} of the splat reversed, so that it is mirrored,",
            mirrored,
            [*photographs],
        )
    for scale in SCALES:
        units = np.array([[1, 1, 1, scale]] * 3 + [[1, 1, 1, 1]])
        name = f"with the positions of the cameras times {scale:.3g}"
        yield name, gaussians, [each.move(each.camera.c2w * units) for each in photographs]
