"""Where things are in a room: which way is up, where the floor is, how high and how large that is.

Photographs come in any unit and any world axes. Up is the direction that most surfaces agree with:
floors, tables and ceilings face it, walls stand along it. The floor is the lowest large surface
that faces up, and the unit of length is the height of the cameras above it: about 1.5 m where
people take photographs, less on most robots.

Cameras that were found from photographs alone have the axes of the first one, however it was held,
which say nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from slgaussian.scene import Camera

REACH = 1 / 45
"""A normal is that of the plane through pixels so far to the left, right, top and bottom, a share
of the image's height."""
STEP = 8
"""One normal is taken in so many rows and columns."""
BEND = 0.02
"""Relative depth by which these pixels may lie off the plane through them."""
STEEP = 0.3
"""Relative difference of depth between opposite ones beyond which they are two surfaces."""
TILT = 50.0
"""Degrees that the cameras may be pitched and rolled on average: up is searched within them."""
NEAR_AXIS = 40.0
"""Degrees from the cameras' upright within which a world axis is tried for up."""
LEVEL = 8.0
"""Degrees by which a surface may be off level or upright and still be evidence for up."""
WALLS = 0.15
"""An upright surface is so much of the evidence that a level one is."""
TWICE = 2.0
"""A world axis is up unless another direction has so many times its evidence, looked at sharply:
most programs that write poses know which way is down."""
FLOOR = 0.03
"""Least share of all surface that a floor has, or what is level."""
THICK = 0.04
"""Floors are found in slices of so many times the median depth."""


@dataclass(frozen=True, eq=False)
class Room:
    """What is known of the place that some views show.

    Attributes
    ----------
    up : float64 [3]
        Unit vector in world coordinates.
    floor : float
        Height of the floor along ``up``, scene units; NaN if none is seen.
    unit : float
        Height of the cameras above the floor or, without one, the median depth; scene units.
    """

    up: np.ndarray
    floor: float
    unit: float

    def place(self, camera: Camera, depth: np.ndarray) -> Surroundings:
        """Where the pixels of a view lie, from its predicted depth float32 [H, W], 0 unknown."""
        known = depth > 0
        points = camera.unproject(depth)
        height = (points @ self.up - self.floor) / self.unit
        normals = _normals(camera, depth)
        return Surroundings(
            np.where(known[..., None], points / self.unit, np.nan).astype(np.float32),
            np.where(known, height, np.nan).astype(np.float32),
            (normals @ self.up).astype(np.float32),
        )


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Where the pixels of one view lie in a room; NaN where that is not known.

    Attributes
    ----------
    points : float32 [H, W, 3]
        World coordinates over the room's unit.
    height : float32 [H, W]
        Above the floor, in the room's unit.
    level : float32 [H, W]
        Cosine between the surface's normal, towards the camera, and up: 1 a floor, -1 a ceiling.
    """

    points: np.ndarray
    height: np.ndarray
    level: np.ndarray


def find_room(cameras: Sequence[Camera], depths: Iterable[np.ndarray]) -> Room:
    """The room that V cameras see, from their predicted depths, float32 [H, W], 0 unknown."""
    points, normals = [], []
    for camera, depth in zip(cameras, depths, strict=True):
        normal = _normals(camera, depth, STEP)
        known = np.isfinite(normal[..., 0])
        points.append(camera.unproject(depth)[::STEP, ::STEP][known])
        normals.append(normal[known])
    eyes = np.array([camera.c2w[:3, 3] for camera in cameras])
    known = np.concatenate([depth[depth > 0] for depth in depths])
    median = float(np.median(known)) if len(known) else 1.0
    up = _up(cameras, np.concatenate(normals))
    facing = np.concatenate(normals) @ up > np.cos(np.radians(1.5 * LEVEL))
    heights = np.concatenate(points) @ up
    floor = _lowest(heights[facing], FLOOR * len(heights), THICK * median)
    eye = float((eyes @ up).mean()) - floor
    if not eye > THICK * median:
        return Room(up, np.nan, median)
    return Room(up, floor, eye)


def _normals(camera: Camera, depth: np.ndarray, step: int = 1) -> np.ndarray:
    """Unit normals towards the camera in world coordinates, float64 [H, W, 3]; NaN if unknown.

    With ``step``, of so many rows and columns one: what ``[::step, ::step]`` takes of all.
    """
    height, width = depth.shape
    out = np.full((-(-height // step), -(-width // step), 3), np.nan)
    r = max(1, round(REACH * height))
    if min(depth.shape) <= 2 * r:
        return out
    first = -(-r // step)  # row and column of ``out`` that is so far from the border

    def beside(down: int, right: int) -> tuple[slice, slice]:
        return (
            slice(first * step + down, height - r + down, step),
            slice(first * step + right, width - r + right, step),
        )

    inner = beside(0, 0)
    sides = beside(0, r), beside(0, -r), beside(r, 0), beside(-r, 0)
    smooth = cv2.medianBlur(depth.astype(np.float32), 5)
    middle = smooth[inner]
    right, left, low, high = (smooth[side] for side in sides)
    flat = (middle > 0) & (np.minimum.reduce([right, left, low, high]) > 0)
    for a, b in ((right, left), (low, high)):
        flat &= (abs(a + b - 2 * middle) < 2 * BEND * middle) & (abs(a - b) < STEEP * middle)
    # A plane for each coordinate: they are several times as fast as triples.
    rays = np.ascontiguousarray(np.moveaxis(camera.rays(), -1, 0))
    points = camera.center[:, None, None] + rays * smooth.astype(np.float64)
    right, left, low, high = (points[:, side[0], side[1]] for side in sides)
    (x, y, z), (u, v, w) = low - high, right - left
    normal = np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.sqrt(_dot(normal, normal))
    eye = camera.c2w[:3, 3, None, None]
    away = _dot(points[:, inner[0], inner[1]] - eye, normal) >= 0
    np.negative(normal, out=normal, where=away)
    out[first : first + len(middle), first : first + middle.shape[1]] = np.moveaxis(
        np.where(flat, normal, np.nan), 0, -1
    )
    return out


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of vectors along the first axis, [3, ...]."""
    product: np.ndarray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def _up(cameras: Sequence[Camera], normals: np.ndarray) -> np.ndarray:
    """Up, from what is known of the cameras and from the normals [N, 3] of surfaces."""
    upright = -np.mean([camera.c2w[:3, 1] for camera in cameras], 0)
    upright /= np.linalg.norm(upright)
    if any(camera.estimated is not None for camera in cameras):
        return _find_up(normals, upright, None)
    axis = np.zeros(3)
    axis[np.abs(upright).argmax()] = np.sign(upright[np.abs(upright).argmax()])
    near = axis @ upright > np.cos(np.radians(NEAR_AXIS))
    return _find_up(normals, upright, axis if near else upright)


def _find_up(normals: np.ndarray, upright: np.ndarray, told: np.ndarray | None) -> np.ndarray:
    """The direction near ``upright`` that the normals [N, 3] speak for most.

    ``told`` is preferred, as :data:`TWICE` has it; without it the normals decide alone, and
    ``upright`` where they say too little.
    """
    near = upright if told is None else told
    if len(normals) == 0:
        return near
    best = upright
    for radius, step in ((TILT, 4.0), (4.0, 1.0)):
        tried = _cap(best, radius, step)
        best = tried[_evidence(normals, tried, LEVEL).argmax()]
    cosine = normals @ best
    level = np.abs(cosine) > np.cos(np.radians(LEVEL))
    if level.mean() < FLOOR:  # walls alone leave a turn open
        return near
    best = (np.sign(cosine[level])[:, None] * normals[level]).sum(0)
    best /= np.linalg.norm(best)
    if told is None:
        return best
    supported = _evidence(normals, np.stack([best, told]), LEVEL / 2)
    return told if supported[0] <= TWICE * supported[1] else best


def _evidence(normals: np.ndarray, ups: np.ndarray, within: float) -> np.ndarray:
    """How much surface is level or upright, ``within`` so many degrees, by ``ups`` [K, 3]."""
    found, most = np.empty(len(ups)), np.cos(np.radians(within))
    steep = np.sin(np.radians(within))
    # One direction after the other, so that all its numbers stay in the cache.
    normals = np.ascontiguousarray(normals.T)
    cosine, part = np.empty((2, normals.shape[1]))
    for k, up in enumerate(ups):
        np.abs(np.dot(up, normals, out=cosine), out=cosine)
        level = (np.maximum(cosine, most, out=part).mean() - most) / (1 - most)
        np.minimum(cosine, steep, out=part)
        wall = 1 - part @ part / (len(part) * steep**2)
        found[k] = level + WALLS * wall
    return found


def _cap(centre: np.ndarray, radius: float, step: float) -> np.ndarray:
    """Directions [K, 3] every ``step`` degrees within ``radius`` of ``centre``."""
    side = np.cross(centre, np.eye(3)[np.abs(centre).argmin()])
    side /= np.linalg.norm(side)
    grid = np.radians(np.arange(-radius, radius + step / 2, step))
    a, b = (part.ravel() for part in np.meshgrid(grid, grid))
    keep = np.hypot(a, b) <= np.radians(radius) * (1 + 1e-9)
    a, b = a[keep, None], b[keep, None]
    angle = np.hypot(a, b)
    along = a * side + b * np.cross(centre, side)
    return np.cos(angle) * centre + np.sinc(angle / np.pi) * along


def _lowest(heights: np.ndarray, least: float, thick: float) -> float:
    """The lowest height at which a slice holds at least ``least`` of ``heights``, or NaN."""
    heights = np.sort(heights)
    reach = np.searchsorted(heights, heights + thick) - np.arange(len(heights))
    full = np.flatnonzero(reach >= max(least, 1))
    if len(full) == 0:
        return np.nan
    first = full[0]
    return float(np.median(heights[first : first + reach[first]]))
