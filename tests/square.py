"""A field with exact ground truth: a wall of three colours behind a square, seen from two sides."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.labels import LabelMaps
from slgaussian.scene import Camera, Sample, View
from tests import pinhole
from tests.known import known_field

H, W, FOCAL, WALL, NEAR = 60, 80, 70.0, 3.0, 2.0
RED, GREEN, BLUE, YELLOW = 4, 6, 7, 11
COLOURS = {RED: (200, 30, 30), GREEN: (40, 150, 50), BLUE: (30, 40, 190), YELLOW: (230, 210, 40)}
HALF = 0.25
"""Half the side of the square, scene units."""


def camera(x: float) -> Camera:
    return pinhole.camera(W, H, FOCAL, place=(x, 0, 0))


def label_view(cam: Camera, square: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return labels int32 [H, W] and depth of a view, with or without the square."""
    size = cam.height, cam.width
    wall, near = (cam.unproject(np.full(size, z)) for z in (WALL, NEAR))
    bands = np.digitize(wall[..., 0], [-0.6, 0.6])
    labels = np.array([RED, GREEN, BLUE], np.int32)[bands]
    inside = (np.abs(near[..., :2]) < HALF).all(-1) & square
    return np.where(inside, YELLOW, labels).astype(np.int32), np.where(inside, NEAR, WALL)


def square_field(
    codes: str, times: int = 1, settings: Mapping[str, Any] | None = None
) -> SemanticField:
    """The field, with ID codes of this strategy; its photographs so many times as large."""
    cameras = [camera(x).resize(times * W, times * H) for x in (-0.4, 0.4)]
    rendered = [label_view(cam) for cam in cameras]
    images = [np.array([COLOURS[i] for i in labels.ravel()], np.uint8) for labels, _ in rendered]
    views = [
        View(name, cam, image.reshape(cam.height, cam.width, 3))
        for name, cam, image in zip("ab", cameras, images, strict=True)
    ]
    labels = np.stack([labels for labels, _ in rendered])
    points = [
        c.unproject(depth).reshape(-1, 3) for c, (_, depth) in zip(cameras, rendered, strict=True)
    ]
    depths = np.concatenate([depth.ravel() for _, depth in rendered])
    n, spacing = len(depths), 0.6 * depths / FOCAL / times
    gaussians = Gaussians(
        means=torch.tensor(np.concatenate(points), dtype=torch.float32),
        scales=torch.tensor(spacing, dtype=torch.float32)[:, None].repeat(1, 3),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        opacities=torch.full((n,), 0.95),
        sh=rgb_to_sh(torch.tensor(np.concatenate(images) / 255, dtype=torch.float32)),
        source=torch.arange(n, dtype=torch.int32),
    )
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    method = Method(codes=codes, keep="all", settings=settings or {})
    return known_field(Sample("wall", tuple(views)), gaussians, maps, method)
