"""Estimation of a room: the up direction, the floor, and a unit of length.

World axes and units are arbitrary. Up is the direction that most surfaces support: normals of
floors, tables and ceilings are parallel to it, normals of walls perpendicular. The floor is the
lowest large surface that faces up, and the unit of length is the height of the cameras above it:
about 1.5 m for photographs by people, less for most robots.

Estimated cameras have the axes of the first camera, which carry no information about up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from slgaussian.scene import Camera

NORMAL_RADIUS = 1 / 45
"""Distance of the left, right, upper and lower pixels that define the plane of a normal, as a share
of the image height."""
STRIDE = 8
"""Stride in rows and columns between normals."""
MAX_BEND = 0.02
"""Largest relative deviation of these pixels from their plane."""
MAX_DEPTH_STEP = 0.3
"""Relative depth difference of opposite pixels above which they lie on two surfaces."""
SEARCH_RADIUS = 50.0
"""Search radius for up around the cameras' mean up vector, degrees."""
MAX_AXIS_ANGLE = 40.0
"""Largest angle between the cameras' mean up vector and a world axis that is tested as up, degrees.
"""
LEVEL_TOLERANCE = 8.0
"""Largest deviation of a surface from horizontal or vertical to count as evidence for up, degrees.
"""
WALL_WEIGHT = 0.15
"""Weight of a vertical surface relative to a horizontal one."""
MIN_EVIDENCE_RATIO = 2.0
"""Ratio of evidence by which another direction must exceed a world axis to be up: most programs
that write poses know the direction of gravity."""
MIN_FLOOR_SHARE = 0.03
"""Smallest share of a floor, and of horizontal surfaces, in the total surface."""
SLICE_THICKNESS = 0.04
"""Thickness of the slices in which floors are detected, in units of the median depth."""


@dataclass(frozen=True, eq=False)
class Room:
    """Up direction, floor and unit of length of a scene.

    Attributes:
        up: float64 [3]. Unit vector in world coordinates.
        floor: Height of the floor along ``up``, scene units; NaN if none is seen.
        unit: Height of the cameras above the floor or, without one, the median depth; scene units.
    """

    up: np.ndarray
    floor: float
    unit: float

    def place(self, camera: Camera, depth: np.ndarray) -> Surroundings:
        """Locate the pixels of a view from its predicted depth float32 [H, W], 0 unknown."""
        valid = depth > 0
        points = camera.unproject(depth)
        height = (points @ self.up - self.floor) / self.unit
        normals = _normals(camera, depth)
        return Surroundings(
            np.where(valid[..., None], points / self.unit, np.nan).astype(np.float32),
            np.where(valid, height, np.nan).astype(np.float32),
            (normals @ self.up).astype(np.float32),
        )


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Positions of the pixels of a view in a room; NaN where unknown.

    Attributes:
        points: float32 [H, W, 3]. World coordinates over the room's unit.
        height: float32 [H, W]. Above the floor, in the room's unit.
        level: float32 [H, W]. Cosine between the surface's normal, towards the camera, and up: 1 a
            floor, -1 a ceiling.
    """

    points: np.ndarray
    height: np.ndarray
    level: np.ndarray


def find_room(cameras: Sequence[Camera], depths: Iterable[np.ndarray]) -> Room:
    """Estimate the room of V cameras from their predicted depths, float32 [H, W], 0 unknown."""
    points, normals = [], []
    for camera, depth in zip(cameras, depths, strict=True):
        normal = _normals(camera, depth, STRIDE)
        valid = np.isfinite(normal[..., 0])
        points.append(camera.unproject(depth)[::STRIDE, ::STRIDE][valid])
        normals.append(normal[valid])
    eyes = np.array([camera.c2w[:3, 3] for camera in cameras])
    valid = np.concatenate([depth[depth > 0] for depth in depths])
    median = float(np.median(valid)) if len(valid) else 1.0
    up = _up(cameras, np.concatenate(normals))
    facing = np.concatenate(normals) @ up > np.cos(np.radians(1.5 * LEVEL_TOLERANCE))
    heights = np.concatenate(points) @ up
    floor = _lowest(heights[facing], MIN_FLOOR_SHARE * len(heights), SLICE_THICKNESS * median)
    eye = float((eyes @ up).mean()) - floor
    if not eye > SLICE_THICKNESS * median:
        return Room(up, np.nan, median)
    return Room(up, floor, eye)


def _normals(camera: Camera, depth: np.ndarray, step: int = 1) -> np.ndarray:
    """Compute unit normals towards the camera in world coordinates, float64 [H, W, 3].

    NaN where unknown. ``step`` subsamples rows and columns as ``[::step, ::step]`` does.
    """
    height, width = depth.shape
    out = np.full((-(-height // step), -(-width // step), 3), np.nan)
    r = max(1, round(NORMAL_RADIUS * height))
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
        flat &= (abs(a + b - 2 * middle) < 2 * MAX_BEND * middle) & (
            abs(a - b) < MAX_DEPTH_STEP * middle
        )
    # A separate array for each coordinate is several times as fast as triples.
    rays = np.ascontiguousarray(np.moveaxis(camera.rays(), -1, 0))
    points = camera.center[:, None, None] + rays * smooth.astype(np.float64)
    right, left, low, high = (points[:, side[0], side[1]] for side in sides)
    (x, y, z), (u, v, w) = low - high, right - left
    normal = np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.sqrt((normal * normal).sum(0))
    eye = camera.c2w[:3, 3, None, None]
    facing_away = ((points[:, inner[0], inner[1]] - eye) * normal).sum(0) >= 0
    np.negative(normal, out=normal, where=facing_away)
    out[first : first + len(middle), first : first + middle.shape[1]] = np.moveaxis(
        np.where(flat, normal, np.nan), 0, -1
    )
    return out


def _up(cameras: Sequence[Camera], normals: np.ndarray) -> np.ndarray:
    """Estimate up from the cameras and the normals [N, 3] of surfaces."""
    upright = -np.mean([camera.c2w[:3, 1] for camera in cameras], 0)
    upright /= np.linalg.norm(upright)
    if any(camera.estimated is not None for camera in cameras):
        return _find_up(normals, upright, None)
    axis = np.zeros(3)
    axis[np.abs(upright).argmax()] = np.sign(upright[np.abs(upright).argmax()])
    near = axis @ upright > np.cos(np.radians(MAX_AXIS_ANGLE))
    return _find_up(normals, upright, axis if near else upright)


def _find_up(normals: np.ndarray, upright: np.ndarray, prior: np.ndarray | None) -> np.ndarray:
    """Find the direction near ``upright`` with most evidence in the normals [N, 3].

    ``prior`` is preferred unless another direction has :data:`MIN_EVIDENCE_RATIO` times its
    evidence.
    """
    near = upright if prior is None else prior
    if len(normals) == 0:
        return near
    best = upright
    for radius, step in ((SEARCH_RADIUS, 4.0), (4.0, 1.0)):
        tried = _cap(best, radius, step)
        best = tried[_evidence(normals, tried, LEVEL_TOLERANCE).argmax()]
    cosine = normals @ best
    level = np.abs(cosine) > np.cos(np.radians(LEVEL_TOLERANCE))
    if level.mean() < MIN_FLOOR_SHARE:  # walls alone leave a turn open
        return near
    best = (np.sign(cosine[level])[:, None] * normals[level]).sum(0)
    best /= np.linalg.norm(best)
    if prior is None:
        return best
    supported = _evidence(normals, np.stack([best, prior]), LEVEL_TOLERANCE / 2)
    return prior if supported[0] <= MIN_EVIDENCE_RATIO * supported[1] else best


def _evidence(normals: np.ndarray, ups: np.ndarray, within: float) -> np.ndarray:
    """Return the evidence for each direction of ``ups`` [K, 3], with tolerance in degrees."""
    evidence, threshold = np.empty(len(ups)), np.cos(np.radians(within))
    steep = np.sin(np.radians(within))
    # One direction after the other, so that all its numbers stay in the cache.
    normals = np.ascontiguousarray(normals.T)
    cosine, part = np.empty((2, normals.shape[1]))
    for k, up in enumerate(ups):
        np.abs(np.dot(up, normals, out=cosine), out=cosine)
        level = (np.maximum(cosine, threshold, out=part).mean() - threshold) / (1 - threshold)
        np.minimum(cosine, steep, out=part)
        wall = 1 - part @ part / (len(part) * steep**2)
        evidence[k] = level + WALL_WEIGHT * wall
    return evidence


def _cap(centre: np.ndarray, radius: float, step: float) -> np.ndarray:
    """Return directions [K, 3] every ``step`` degrees within ``radius`` of ``centre``."""
    side = np.cross(centre, np.eye(3)[np.abs(centre).argmin()])
    side /= np.linalg.norm(side)
    grid = np.radians(np.arange(-radius, radius + step / 2, step))
    a, b = (part.ravel() for part in np.meshgrid(grid, grid))
    keep = np.hypot(a, b) <= np.radians(radius) * (1 + 1e-9)
    a, b = a[keep, None], b[keep, None]
    angle = np.hypot(a, b)
    along = a * side + b * np.cross(centre, side)
    return np.cos(angle) * centre + np.sinc(angle / np.pi) * along


def _lowest(heights: np.ndarray, min_count: float, thick: float) -> float:
    """Return the lowest height at which a slice has at least ``min_count`` heights, or NaN."""
    heights = np.sort(heights)
    reach = np.searchsorted(heights, heights + thick) - np.arange(len(heights))
    full = np.flatnonzero(reach >= max(min_count, 1))
    if len(full) == 0:
        return np.nan
    first = full[0]
    return float(np.median(heights[first : first + reach[first]]))
