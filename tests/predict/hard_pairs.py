"""Pairs of views on which two-view geometry breaks, by name.

All show one small stage with a floor, walls and things at several depths, ray-cast so that its
depth is exact; what is hard is in the cameras, the surfaces or the photographs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from slgaussian.datasets.procedural import raycast, shading, textures
from slgaussian.datasets.procedural.raycast import BALL, BOX, CYLINDER, Solid
from slgaussian.datasets.procedural.textures import (
    CHECKED,
    PHOTO,
    PLAIN,
    SPECKLED,
    WOODEN,
    Material,
)
from slgaussian.scene import Camera, Sample, View

SIZE = (120, 160)
LEFT, RIGHT = {"right": -0.2}, {"right": 0.2}
"""The plain pair of views, 0.4 m apart: 17 to 33 pixels of parallax."""


@cache
def case(name: str) -> Sample:
    return CASES[name]()


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
    observed = np.zeros(view.depth.shape, bool)
    for alternative in (
        alternative.camera for alternative in sample.context if alternative is not view
    ):
        pixels, z = alternative.project(view.camera.unproject(view.depth))
        observed |= (
            (z > 0)
            & (pixels >= 0).all(-1)
            & (pixels < (alternative.width, alternative.height)).all(-1)
        )
    return observed & (view.depth > 0)


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
    """What these cameras see of the stage; settings as in :func:`photograph`."""
    views = (photograph(f"view{i}", c, **settings) for i, c in enumerate(cameras))
    return Sample("stage", tuple(views))


def poses_a_little_wrong():
    """One given pose turned by 0.36 degrees and shifted by 4 % of the baseline."""
    true = stage(camera(**LEFT), camera(**RIGHT))
    first, second = true.context
    c2w = second.camera.c2w.copy()
    c2w[:3, :3] = c2w[:3, :3] @ turn(0.3, 0.2, 0)
    c2w[:3, 3] += 0, 0.012, 0.012
    return replace(true, context=(first, replace(second, camera=replace(second.camera, c2w=c2w))))


def _in_units(unit: float) -> Sample:
    true = stage(camera(**LEFT), camera(**RIGHT))
    views = []
    for view in true.context:
        c2w = view.camera.c2w.copy()
        c2w[:3, 3] *= unit
        moved = replace(view.camera, c2w=c2w)
        views.append(replace(view, camera=moved, depth=view.depth * np.float32(unit)))
    return replace(true, context=tuple(views))


PICTURES = (
    (CAT, Solid(BOX, (0.3, 0.02, 0.3), (0.25, 1.68, 1.35))),
    (RED, Solid(BOX, (0.2, 0.02, 0.15), (-1.0, 1.68, 1.2))),
)


def blank_wall():
    """Nothing on the back wall but two pictures."""
    blank = Material(PLAIN, (0.4, 0.4, 0.4))
    return stage(camera(**LEFT), camera(**RIGHT), wall=blank, extra=PICTURES)


def repeated_texture():
    """Checks on the back wall repeat every 7 pixels; parallax goes from 17 to 33."""
    checks = Material(CHECKED, (0.7, 0.7, 0.7), (0.1, 0.1, 0.1), cell=0.08, gloss=0.0)
    return stage(camera(**LEFT), camera(**RIGHT), wall=checks)


def something_in_front():
    """A post at less than half the distance of all else hides a tenth of each view."""
    post = (RED, Solid(CYLINDER, (0.07, 1.6), (0.1, -0.7, 1.6)))
    return stage(camera(**LEFT), camera(**RIGHT), extra=[post])


def exposure_change():
    """One view has twice the light, and some of it is clipped."""
    first = photograph("view0", camera(**LEFT))
    return Sample("stage", (first, photograph("view1", camera(**RIGHT), gain=2.0)))


def another_white_balance():
    """One view has half as much red again and a third less blue."""
    first = photograph("view0", camera(**LEFT))
    return Sample("stage", (first, photograph("view1", camera(**RIGHT), gain=(1.5, 1.0, 0.67))))


def one_view_out_of_focus():
    """One view blurred by 1.5 pixels."""
    true = stage(camera(**LEFT), camera(**RIGHT))
    first, second = true.context
    blurred = replace(second, image=cv2.GaussianBlur(second.image, (0, 0), 1.5))
    return replace(true, context=(first, blurred))


CASES: dict[str, Callable[[], Sample]] = {
    # Nothing: what the others are compared with.
    "side_by_side": lambda: stage(camera(**LEFT), camera(**RIGHT)),
    # One camera above the other.
    "vertical_baseline": lambda: stage(camera(down=-0.2), camera(down=0.2)),
    # 0.7 m apart, each turned inwards by 8 degrees.
    "converging_views": lambda: stage(camera(right=-0.35, yaw=8), camera(right=0.35, yaw=-8)),
    # Straight ahead: the epipole, where nothing moves, is in the middle of both images.
    "forward_motion": lambda: stage(camera(forward=-0.3), camera(forward=0.3)),
    # One camera 1.2 m behind the other, so that everything is half as large again in one.
    "one_view_far_behind_the_other": lambda: stage(
        camera(right=0.1, forward=0.4), camera(forward=-0.8)
    ),
    # Two pixels of parallax over the whole scene, of which half a pixel tells near from far.
    "tiny_baseline": lambda: stage(camera(), camera(right=0.03)),
    # 40 % overlap.
    "wide_baseline": lambda: stage(camera(right=-0.3, yaw=-11), camera(right=0.3, yaw=11)),
    # 1.4 m apart at 1.8 to 3.5 m: what is seen from 30 degrees aside looks different.
    "wide_angle_between_the_views": lambda: stage(
        camera(right=-0.7, yaw=4), camera(right=0.7, yaw=-4)
    ),
    # One camera held upright, the other across.
    "rolled_by_a_quarter_turn": lambda: stage(camera(**LEFT), camera(**RIGHT, roll=90)),
    # One camera held upside down.
    "upside_down": lambda: stage(camera(**LEFT), camera(**RIGHT, roll=180)),
    # The baseline is 4e-4.
    "scene_units_of_a_kilometre": lambda: _in_units(1e-3),
    # The baseline is 4e3.
    "scene_units_of_a_tenth_of_a_millimetre": lambda: _in_units(1e4),
    # One more to the right and one above.
    "three_views": lambda: stage(camera(), camera(right=0.35), camera(right=-0.1, down=-0.25)),
    # Crops of larger photographs, by 50 and 40 of 80 pixels across and 30 of 60 down.
    "principal_point_far_from_the_centre": lambda: stage(
        camera(**LEFT, principal=(30, 90), yaw=-15, pitch=-10),
        camera(**RIGHT, principal=(40, 90), yaw=-15, pitch=-10),
    ),
    # One view zoomed in by 1.75.
    "different_intrinsics": lambda: stage(camera(**LEFT, focal=120), camera(**RIGHT, focal=210)),
    # Half as high again as wide.
    "pixels_that_are_not_square": lambda: stage(
        camera(**LEFT, focal=(150, 100)), camera(**RIGHT, focal=(160, 105))
    ),
    # Higher than wide.
    "portrait_images": lambda: stage(
        camera(**LEFT, size=(160, 120)), camera(**RIGHT, size=(160, 120))
    ),
    # 116 degrees across.
    "wide_angle_lens": lambda: stage(camera(**LEFT, focal=50), camera(**RIGHT, focal=50)),
    # 10 degrees across, from 22 m, 150 baselines away.
    "long_lens": lambda: stage(
        camera(right=-0.075, forward=-20, focal=900), camera(right=0.075, forward=-20, focal=900)
    ),
    # A twentieth of the light: the brightest parts are at 60 of 255.
    "dark_photographs": lambda: stage(camera(**LEFT), camera(**RIGHT), gain=0.05),
    # A standard deviation of 5 % of full scale.
    "sensor_noise": lambda: stage(camera(**LEFT), camera(**RIGHT), noise=0.05),
    "poses_a_little_wrong": poses_a_little_wrong,
    "blank_wall": blank_wall,
    "repeated_texture": repeated_texture,
    "something_in_front": something_in_front,
    "exposure_change": exposure_change,
    "another_white_balance": another_white_balance,
    "one_view_out_of_focus": one_view_out_of_focus,
}
