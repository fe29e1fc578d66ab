"""Seeded procedural indoor scenes with exact depth, object ids and names."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from slgaussian.datasets.procedural import raycast
from slgaussian.datasets.procedural.rooms import FOCUS, MAX_OBJECTS, Room, furnish
from slgaussian.datasets.procedural.shading import photograph
from slgaussian.errors import InputError
from slgaussian.formats.colour import encode_srgb
from slgaussian.kernels.seeding import rng_for
from slgaussian.scene import Camera, Scene, View

FOCAL = 0.9  # focal length as a fraction of the longer image side, as of a phone's main camera


def read(
    seed: int = 0,
    objects: int = 8,
    views: int = 4,
    height: int = 416,
    width: int = 576,
    baseline: float = 0.6,
    noise: float = 0.008,
    exposure: float = 0.05,
) -> Scene:
    """Make a small furnished room and its cameras; views are rendered when they are read.

    The views lie on an arc around the room's centre: the first, "view_00", and the last form a
    two-view pair, and those between are novel views. The room depends only on ``seed``,
    ``objects`` and ``baseline``, and a view also on its position and size: the same arguments give
    the same bytes.

    Args:
        objects: Free-standing balls, boxes, cylinders, cones and rings, 1 to 16, besides the floor,
            walls, ceiling and perhaps a carpet, a table and a picture. All are visible from both
            ends of the arc.
        views: At least 2.
        height, width: Image size in pixels, at least 16 each.
        baseline: Distance in metres between the first and the last camera, which are about 3.3 m
            from the room's centre; at most 2.
        noise: Standard deviation of the sensor noise, as a fraction of full scale.
        exposure: Standard deviation of the natural logarithm of each view's exposure.

    Returns:
        Scene: World in metres with z up. Depth and instance ids are those of the ray through the
            pixel centre; ``phrases`` names every id uniquely.

    Raises:
        InputError: If an argument is out of range.
    """
    for option, value, low, high in (
        ("objects", objects, 1, MAX_OBJECTS), ("views", views, 2, 1000),
        ("height", height, 16, 8192), ("width", width, 16, 8192),
        ("baseline", baseline, 0.01, 2.0), ("noise", noise, 0.0, 1.0),
        ("exposure", exposure, 0.0, 1.0),
    ):  # fmt: skip
        kind = "whole number" if isinstance(low, int) else "number"
        if not low <= value <= high or (isinstance(low, int) and value != int(value)):
            raise InputError(
                f"procedural scene {option}: found {value}, expected a {kind} from {low} to {high}"
            )
    name = f"procedural_{seed}"
    arc = rng_for(seed, name, "arc")
    start, lift, distance = arc.uniform((-0.12, 1.25, 3.15), (0.12, 1.55, 3.4))
    half = math.asin(baseline / 2 / distance)

    def camera(fraction: float, h: int, w: int) -> Camera:
        """Return the camera at ``fraction`` (-1 to 1) of the arc."""
        angle = start + fraction * half
        eye = FOCUS + [distance * math.sin(angle), -distance * math.cos(angle), lift - FOCUS[2]]
        focal = FOCAL * max(h, w)
        K = np.array([[focal, 0, w / 2], [0, focal, h / 2], [0, 0, 1.0]])
        return Camera(K, _look_at(eye, FOCUS), w, h)

    # Visibility is tested on small images of one size, so the room is equal at any resolution.
    ends = [camera(fraction, 52, 72) for fraction in (-1, 1)]
    room = furnish(rng_for(seed, name, f"room {objects} {float(baseline)}"), objects, ends)
    phrases = {i: thing.phrase for i, thing in enumerate(room.things, 1)}
    cameras = {
        f"view_{i:02d}": camera(2 * i / (views - 1) - 1, height, width) for i in range(views)
    }
    return Scene(name, cameras, partial(_read, seed, room, cameras, noise, exposure), phrases)


def _read(
    seed: int, room: Room, cameras: dict[str, Camera], noise: float, exposure: float, name: str
) -> View:
    """Render one view."""
    scene = f"procedural_{seed}"
    if name not in cameras:
        raise InputError(f"scene {scene!r}: no view {name!r}; see its cameras")
    camera, solids = cameras[name], room.solids()
    materials = room.materials(rng_for(seed, scene, "materials"))
    light = photograph(solids, room.solids(casters=True), materials, room.light, camera)
    depth, index = raycast.cast(solids, camera.center, camera.rays())
    rng = rng_for(seed, scene, name)
    gain = math.exp(rng.normal(0.0, 1.0) * exposure)
    srgb = _map_tones(light * gain)
    if noise:
        srgb += rng.normal(0.0, noise, srgb.shape)
    image = np.round(np.clip(srgb, 0, 1) * 255).astype(np.uint8)
    return View(name, camera, image, depth.astype(np.float32), room.owners()[index])


def _look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return camera-to-world of a level camera at ``eye`` looking at ``target``; z is up."""
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    c2w = np.eye(4)
    c2w[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    c2w[:3, 3] = eye
    return c2w


def _map_tones(light: np.ndarray) -> np.ndarray:
    """Encode linear light as sRGB in [0, 1] (IEC 61966-2-1) with soft highlight clipping."""
    knee = 0.8
    excess = np.maximum(light - knee, 0) / (1 - knee)
    light = np.where(light > knee, knee + (1 - knee) * excess / (1 + excess), light)
    return encode_srgb(light)
