"""Views of a splat: the choice of those that are labelled, and renderings without photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slgaussian.cameras.paths import ring
from slgaussian.datasets.sharpness import blur, small
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.labels import MIN_WEIGHT
from slgaussian.rasterize.label_weights import sum_label_weights
from slgaussian.rasterize.picture import compute_view_colours, picture
from slgaussian.scene import Camera, Sample, Size, View, fit_size

MIN_VIEWS, SEEN_SHARE = 5, 0.75
"""Number of views that are labelled at least, where there are as many, and the share of what all
views show at which there are enough: masks and descriptors take 2.5 processor s a view."""

RING_VIEWS, RING_SIZE = 12, (416, 576)
"""Number of views on a path around a splat, and their height and width."""

CORE_SHARE = 0.9
"""Share of the Gaussians nearest to the middle of a splat that count for its extent: the rest may
be far background."""

INNER_RADIUS = 0.5
"""Radius of a ring within a splat, as a share of the median distance of its Gaussians."""

ENCLOSED_SHARE = 0.8
"""Share of the pixels of views outwards that show Gaussians where a splat is a room."""

SMALL_SIDE = 120
"""Shorter side, pixels, of the renderings by which views are chosen."""


def choose_views(sample: Sample, gaussians: Gaussians) -> Sample:
    """Choose context views that show nearly every Gaussian as well as the best of all views does.

    Greedily by the sum over the Gaussians of the largest blending weight in a chosen view, until
    there are :data:`MIN_VIEWS` and it is :data:`SEEN_SHARE` of that in all views. The weight in a
    blurred photograph counts less (:func:`slgaussian.datasets.sharpness.blur`).
    """
    if len(sample.context) <= MIN_VIEWS:
        return sample
    weights, best = [], np.zeros(len(gaussians), np.float32)
    for view in sample.context:
        camera = _shrink(view.camera)
        everywhere = np.zeros((camera.height, camera.width), np.int32)
        seen = sum_label_weights(gaussians, [everywhere], [camera], 1).tocoo()
        rows, weight = seen.coords[0], (seen.data * (1 - blur(small(view.image)))).astype("f4")
        weights.append((rows, weight))
        best[rows] = np.maximum(best[rows], weight)
    shown, chosen = np.zeros_like(best), list[int]()
    while len(chosen) < MIN_VIEWS or shown.sum() < SEEN_SHARE * best.sum():
        gains = [np.maximum(weight - shown[rows], 0).sum() for rows, weight in weights]
        chosen.append(int(np.argmax([-1 if v in chosen else gain for v, gain in enumerate(gains)])))
        rows, weight = weights[chosen[-1]]
        shown[rows] = np.maximum(shown[rows], weight)
    context = tuple(sample.context[v] for v in sorted(chosen))
    return replace(sample, context=context, matches=None)


def _shrink(camera: Camera) -> Camera:
    scale = min(1.0, SMALL_SIDE / min(camera.width, camera.height))
    return camera.resize(round(camera.width * scale), round(camera.height * scale))


def render_sample(
    scene: str, gaussians: Gaussians, cameras: Mapping[str, Camera], size: Size, rendered: str
) -> Sample:
    """Render a splat at cameras by the image formation of 3D Gaussian splatting.

    Pixels without Gaussians are transparent. ``size`` as in :meth:`slgaussian.scene.Scene.sample`,
    ``rendered`` as in :class:`slgaussian.scene.Sample`.

    Raises:
        InputError: If no camera shows any of it, and as :class:`slgaussian.scene.Sample`.
    """
    views = []
    for name, camera in cameras.items():
        if size != "original":
            camera = camera.resize(*fit_size(camera.height, camera.width, size)[::-1])
        drawn = picture(gaussians, compute_view_colours(gaussians, camera), camera, "3dgs")
        image = (drawn.values.clip(0, 1) * 255 + 0.5).astype(np.uint8)
        views.append(View(name, camera, image, opaque=drawn.alpha >= MIN_WEIGHT))
    if not any(view.opaque is not None and view.opaque.any() for view in views):
        raise InputError(f"{scene}: none of the {len(views)} cameras shows any of its Gaussians")
    return Sample(scene, tuple(views), rendered=rendered)


def surround(gaussians: Gaussians, count: int = RING_VIEWS) -> dict[str, Camera]:
    """Return cameras on a ring around a splat, or within it if it encloses its middle.

    Up is the direction in which the splat extends least: of the two, the nearer to -y, as in worlds
    of COLMAP, or, if it is nearer to the z axis, to +z, as in those of nerfstudio.
    """
    arrays = gaussians.to_arrays()
    points = arrays["means"][arrays["opacities"] >= MIN_WEIGHT].astype(np.float64)
    points = points if len(points) else arrays["means"].astype(np.float64)
    middle = np.median(points, 0)
    distances = np.linalg.norm(points - middle, axis=1)
    points = points[distances <= np.quantile(distances, CORE_SHARE)]
    up = np.linalg.svd(np.cov((points - middle).T))[2][2]
    main = int(np.abs(up).argmax())
    up = up * np.sign(up[main]) * (1 if main == 2 else -1)
    level = points - middle
    level = np.linalg.norm(level - np.outer(level @ up, up), axis=1)
    height, width = RING_SIZE
    K = np.array([[width * 0.8, 0, width / 2], [0, width * 0.8, height / 2], [0, 0, 1.0]])
    camera = Camera(K, np.eye(4), width, height)
    middle = middle + gaussians.origin
    radius = INNER_RADIUS * float(np.median(level))
    if not _encloses(gaussians, ring(middle, up, radius, camera, 4)):
        # So that the core fills the width.
        radius = float(np.quantile(level, CORE_SHARE)) * (1 + 2 * K[0, 0] / width)
    cameras = ring(middle, up, max(radius, 1e-6), camera, count)
    return {f"view_{number:02d}": camera for number, camera in enumerate(cameras)}


def _encloses(gaussians: Gaussians, cameras: Sequence[Camera]) -> bool:
    """Return whether the cameras see Gaussians nearly everywhere, looking out of a splat."""
    covered = []
    for camera in cameras:
        turned = camera.c2w @ np.diag([-1.0, 1, -1, 1])
        small_camera = _shrink(replace(camera, c2w=turned))
        nothing = np.zeros((len(gaussians), 1), np.float32)
        covered.append((picture(gaussians, nothing, small_camera).alpha >= MIN_WEIGHT).mean())
    return bool(min(covered) >= ENCLOSED_SHARE)
