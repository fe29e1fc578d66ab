"""Pairs of views that are hard for two-view geometry, by name.

All show one small stage with a floor, walls and things at several depths, ray-cast so that its
depth is exact; what is hard is in the cameras, the surfaces or the photographs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from slgaussian.datasets.procedural import raycast, shading, textures
from slgaussian.datasets.procedural.raycast import BALL, BOX, CYLINDER, Solid
from slgaussian.datasets.procedural.textures import PHOTO, PLAIN, SPECKLED, WOODEN, Material
from slgaussian.scene import Camera, Sample, View

SIZE = (120, 160)
LEFT, RIGHT = {"right": -0.2}, {"right": 0.2}
"""The plain pair of views, 0.4 m apart: 17 to 33 pixels of parallax."""


@dataclass(frozen=True)
class Scores:
    """Mean and median relative depth error, and the share within a factor of 1.25."""

    mean: float
    median: float
    close: float


def judge(sample: Sample, depths: np.ndarray, mask: Sequence[np.ndarray] | None = None) -> Scores:
    """Score depth maps [V, H, W] over the pixels whose surface falls inside another view.

    ``where`` bool, V of [H, W], leaves out more of them.
    """
    ratios = []
    for i, (view, depth) in enumerate(zip(sample.context, depths, strict=True)):
        judged = seen_elsewhere(sample, i)
        if mask is not None:
            judged &= mask[i]
        ratios.append(depth[judged] / view.depth[judged])
    ratio = np.concatenate(ratios)
    off = np.abs(ratio - 1)
    close = np.maximum(ratio, 1 / ratio) < 1.25
    return Scores(float(off.mean()), float(np.median(off)), float(close.mean()))


def seen_elsewhere(sample: Sample, index: int) -> np.ndarray:
    """Pixels of a view, bool [H, W], whose surface falls inside the image of another."""
    view = sample.context[index]
    points = view.camera.unproject(view.depth)
    cameras = [other.camera for other in sample.context if other is not view]
    inside = [camera.shows(*camera.project(points)) for camera in cameras]
    return np.any(inside, 0) & (view.depth > 0)


# The stage: metres, z up; the cameras look along y, a little down.

FLOOR = Material(PHOTO, (0.5, 0.45, 0.4), cell=1.7, photo="gravel", gloss=0.0)
PHOTO_WALL = Material(PHOTO, (0.9, 0.9, 0.9), cell=2.6, photo="coffee", gloss=0.0)
SIDE = Material(PHOTO, (0.4, 0.5, 0.35), cell=2.0, photo="grass", gloss=0.0)
CAT = Material(PHOTO, (0.9, 0.9, 0.9), cell=0.7, photo="chelsea", gloss=0.0)
RED = Material(SPECKLED, (0.5, 0.1, 0.1), (0.8, 0.8, 0.7), cell=0.05)
WOOD = Material(WOODEN, (0.66, 0.43, 0.24), (0.3, 0.17, 0.08), cell=0.1)
SHELL = (
    (FLOOR, Solid(BOX, (3.5, 5.0, 0.1), (0, 0, -0.1))),
    (SIDE, Solid(BOX, (0.1, 5.0, 1.6), (-3.6, 0, 1.6))),
    (SIDE, Solid(BOX, (0.1, 5.0, 1.6), (3.6, 0, 1.6))),
)
THINGS = (
    (CAT, Solid(BOX, (0.35, 0.25, 0.35), (-0.6, 0.9, 0.35))),
    (RED, Solid(BALL, (0.3,), (0.25, 0.35, 0.3))),
    (WOOD, Solid(CYLINDER, (0.16, 0.55), (0.95, 0.8, 0.55))),
)
WALL = len(SHELL)
"""Row of the back wall among the solids, as in ``View.instances``."""

LIGHT = shading.Light(np.array([-0.8, -1.0, 2.9]), half=0.3, power=0.8, reach=2.6, ambient=0.4)
EYE = np.array([0.0, -1.7, 1.0])
SINK = np.radians(7)


def camera(
    right: float = 0.0,
    down: float = 0.0,
    forward: float = 0.0,
    yaw: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
    size: tuple[int, int] = SIZE,
    focal: float | tuple[float, float] = 150.0,
    principal: tuple[float, float] | None = None,
    **limits: float,
) -> Camera:
    """A camera moved along its axes from where the stage is seen well, then turned (degrees).

    ``size`` is (H, W), ``focal`` one or (x, y), in pixels; ``limits`` are its near and far.
    """
    H, W = size
    fx, fy = focal if isinstance(focal, tuple) else (focal, focal)
    cx, cy = principal or (W / 2, H / 2)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    c, s = np.cos(SINK), np.sin(SINK)
    level = np.array([[1, 0, 0], [0, -s, c], [0, -c, -s]])
    c2w = np.eye(4)
    c2w[:3, 3] = EYE + level @ (right, down, forward)
    c2w[:3, :3] = level @ turn(yaw, pitch, roll)
    return Camera(K, c2w, W, H, **limits)


def turn(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Rotation [3, 3] in camera axes: to the right, then up, then clockwise, in degrees."""
    axes = np.radians([(0, yaw, 0), (pitch, 0, 0), (0, 0, roll)])
    first, second, third = (cv2.Rodrigues(axis)[0] for axis in axes)
    return first @ second @ third


def photograph(
    name: str,
    camera: Camera,
    wall: Material = PHOTO_WALL,
    extra: Sequence[tuple[Material, Solid]] = (),
    gain: float | tuple[float, float, float] = 1.0,
    noise: float = 0.006,
) -> View:
    """A view of the stage with this back wall and more things on it.

    ``gain`` is on linear light, ``noise`` a share of full scale. A PLAIN wall is really blank.
    """
    back = (wall, Solid(BOX, (3.5, 0.1, 1.6), (0, 1.8, 1.6)))
    stage = (*SHELL, back, *THINGS, *extra)
    solids = raycast.pack([solid for _, solid in stage])
    casters = raycast.pack([solid for _, solid in stage[WALL + 1 :]])
    # A fixed seed: the grain of a surface belongs to the stage, not to the view.
    materials = textures.pack([material for material, _ in stage], np.random.default_rng(0))
    light = shading.photograph(solids, casters, materials, LIGHT, camera)
    depth, index = raycast.cast(solids, camera.center, camera.rays())
    if wall.pattern == PLAIN:
        light[index == WALL] = wall.first
    light = np.clip(light * gain, 0, 1)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    rng = np.random.default_rng(list(name.encode()))
    srgb = srgb + rng.normal(0, noise, srgb.shape)
    image = np.round(srgb.clip(0, 1) * 255).astype(np.uint8)
    depth = np.where(index < 0, 0, depth).astype(np.float32)
    return View(name, camera, image, depth, index.astype(np.int32))


def stage(*cameras: Camera, **settings) -> Sample:
    """Render the stage for cameras; settings as in :func:`photograph`."""
    views = (photograph(f"view{i}", c, **settings) for i, c in enumerate(cameras))
    return Sample("stage", tuple(views))


def poses_a_little_wrong() -> Sample:
    """One given pose turned by 0.36 degrees and shifted by 4 % of the baseline."""
    true = stage(camera(**LEFT), camera(**RIGHT))
    first, second = true.context
    c2w = second.camera.c2w.copy()
    c2w[:3, :3] = c2w[:3, :3] @ turn(0.3, 0.2, 0)
    c2w[:3, 3] += 0, 0.012, 0.012
    return replace(true, context=(first, replace(second, camera=replace(second.camera, c2w=c2w))))


def in_units(unit: float) -> Sample:
    """The plain pair in so many units a metre."""
    true = stage(camera(**LEFT), camera(**RIGHT))
    views = []
    for view in true.context:
        c2w = view.camera.c2w.copy()
        c2w[:3, 3] *= unit
        moved = replace(view.camera, c2w=c2w)
        views.append(replace(view, camera=moved, depth=view.depth * np.float32(unit)))
    return replace(true, context=tuple(views))
