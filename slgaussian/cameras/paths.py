"""Camera paths: interpolation between two cameras, an orbit among several, and a ring.

The first two stay among the cameras, because no photograph shows what lies beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import ROUNDING, Camera

MIN_AXIS_COSINE = np.cos(np.radians(45))
"""An orbit uses the cameras whose viewing directions are within 45 degrees of the central one: the
mean position of cameras all around an object is inside the object."""

MIN_AXIS_RATIO = 0.3
"""Smallest ratio of the half axes of an orbit: above and below the baseline of two cameras, parts
of the scene appear that neither shows. At 0.3, at most 0.3 % of a frame is empty in an office hall,
0.6 % in a kitchen and 5.5 % in a street that is driven along."""

RING_ELEVATION = np.radians(20)
"""Angle by which the cameras of a ring look down."""


def between(a: Camera, b: Camera, t: float) -> Camera:
    """Interpolate the camera at fraction ``t`` of the way from ``a`` to ``b``.

    Position and intrinsics are interpolated, the orientation by slerp (Shoemake, "Animating
    Rotation with Quaternion Curves", SIGGRAPH 1985): a rotation about one axis at a constant rate,
    along the shorter arc. ``between(a, b, t)`` equals ``between(b, a, 1 - t)`` except for the image
    size and the depth range, which are the first camera's. The second image is scaled isotropically
    to the pixel count of the first and centred on it, so a ball stays round on the way from a
    landscape photograph to a portrait.

    Args:
        t: float in [0, 1]

    Raises:
        InputError: If ``t`` is outside [0, 1], or the cameras differ by a half turn, whose axis is
            ambiguous.
    """
    if not 0 <= t <= 1:
        raise InputError(
            f"between: found {t:g}, expected a share of the way from 0 to 1; beyond the two views "
            "nothing was seen"
        )
    from scipy.spatial.transform import Rotation, Slerp

    ends = Rotation.from_matrix([a.c2w[:3, :3], b.c2w[:3, :3]])
    # The axis of a half turn is ambiguous and would be determined by noise.
    if (ends[0].inv() * ends[1]).magnitude() > np.pi - 1e-6:
        raise InputError("between: the two views are half a turn apart, so no way leads between")
    c2w = np.eye(4)
    c2w[:3, :3] = Slerp([0, 1], ends)(t).as_matrix()
    c2w[:3, 3] = (1 - t) * a.center + t * b.center
    size, second_size = (np.array([camera.width, camera.height]) for camera in (a, b))
    scale = np.sqrt(size.prod() / second_size.prod())
    K = b.K * [[scale], [scale], [1]]
    K[:2, 2] += (size - scale * second_size) / 2
    return replace(a, K=(1 - t) * a.K + t * K, c2w=c2w)


def orbit(cameras: Sequence[Camera], points: np.ndarray, n: int) -> list[Camera]:
    """Return ``n`` viewpoints evenly along an ellipse among ``cameras``, aimed at one point.

    The centre is the mean of the cameras, in position and orientation. The plane is spanned by the
    two directions in which the cameras spread most; the half axes reach as far as the cameras do,
    and the shorter is at least 0.3 of the longer. With two cameras this is an ellipse along the
    baseline, from the first camera's position past the second's and back. Every viewpoint is aimed
    at the point on the central optical axis at the median depth of ``points``, without roll.
    Cameras that look in other directions (:data:`MIN_AXIS_COSINE`) are left out.

    Args:
        cameras: sequence of Camera. Two or more; size, intrinsics and depth range are those of the
            camera nearest to the centre.
        points: float [N, 3]. Surface points in the world, such as the means of Gaussians.
        n: Number of viewpoints; the last is one step before the first, so that a film can loop.

    Raises:
        InputError: If there are fewer than two cameras or viewpoints, all cameras are at one
            position, or no point lies in front of them.
    """
    if n < 2 or len(cameras) < 2:
        raise InputError(
            f"orbit: found {n} frames among {len(cameras)} cameras, expected at least two of each"
        )
    from scipy.spatial.transform import Rotation

    axes = np.stack([camera.c2w[:3, 2] for camera in cameras])
    cosines = axes @ axes.T
    cosines = cosines[cosines.clip(MIN_AXIS_COSINE).sum(1).argmax()]
    # If only two cameras are given and they look in different directions, both are used.
    similar = cosines >= min(MIN_AXIS_COSINE, np.sort(cosines)[-2])
    cameras = [camera for camera, used in zip(cameras, similar, strict=True) if used]
    centers = np.stack([camera.center for camera in cameras])
    start = cameras[int(np.linalg.norm(centers - centers.mean(0), axis=1).argmin())]
    middle = np.eye(4)
    turns = Rotation.from_matrix([camera.c2w[:3, :3] for camera in cameras])
    middle[:3, :3], middle[:3, 3] = turns.mean().as_matrix(), centers.mean(0)
    start = replace(start, c2w=middle)
    rounding = ROUNDING * float(np.abs(centers).max())
    along, across = _half_axes(centers - start.center, start.c2w[:3, :2].T, rounding)
    pixels, z = start.project(np.asarray(points, np.float64))
    inside = start.shows(pixels, z)
    if not inside.any():
        raise InputError("orbit: nothing lies before the cameras, so there is nothing to aim at")
    focus = start.center + np.median(z[inside]) * start.c2w[:3, 2]
    angles = 2 * np.pi * np.arange(n) / n
    places = start.center - np.outer(np.cos(angles), along) + np.outer(np.sin(angles), across)
    return [_aim(start, place, focus) for place in places]


def ring(middle: np.ndarray, up: np.ndarray, radius: float, camera: Camera, n: int) -> list[Camera]:
    """Return ``n`` viewpoints evenly on a circle around ``middle``, upright and aimed at it.

    The circle is :data:`RING_ELEVATION` above the plane through ``middle``.

    Args:
        middle, up: float [3]. Point in the world, and the direction up, of length 1.
        radius: Distance of the viewpoints from ``middle``, scene units.
        camera: Size and intrinsics.
    """
    across = np.linalg.svd(up[None])[2][1:]  # two directions orthogonal to up
    viewpoints = []
    for angle in 2 * np.pi * np.arange(n) / n:
        level = np.cos(angle) * across[0] + np.sin(angle) * across[1]
        forward = -np.cos(RING_ELEVATION) * level - np.sin(RING_ELEVATION) * up
        right = np.cross(forward, up) / np.cos(RING_ELEVATION)
        c2w = np.eye(4)
        c2w[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
        c2w[:3, 3] = middle - radius * forward
        viewpoints.append(replace(camera, c2w=c2w))
    return viewpoints


def _half_axes(
    offsets: np.ndarray, image_axes: np.ndarray, rounding: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the half axes, float [3] each, of the ellipse of cameras at ``offsets`` [V, 3].

    Offsets up to ``rounding`` are none.
    """
    directions = np.linalg.svd(offsets)[2]
    along = directions[0]
    reach = np.abs(offsets @ along).max()
    if reach <= rounding:
        raise InputError("orbit: all cameras are in one place, so there is no way round it")
    along = along * (1 if offsets[-1] @ along >= offsets[0] @ along else -1)
    second = np.abs(offsets @ directions[1]).max()
    if second >= MIN_AXIS_RATIO * reach:
        across = directions[1]
    else:
        # Orthogonal to the baseline and parallel to the image: vertical for cameras side by side.
        across = max((axis - (axis @ along) * along for axis in image_axes), key=np.linalg.norm)
        across, second = across / np.linalg.norm(across), MIN_AXIS_RATIO * reach
    across = across * (1 if across @ image_axes[1] <= 0 else -1)
    return reach * along, second * across


def _aim(camera: Camera, place: np.ndarray, focus: np.ndarray) -> Camera:
    """Return ``camera`` moved to ``place`` and rotated minimally so that ``focus`` is projected to
    the centre."""
    before, after = camera.c2w[:3, 2], focus - place
    axis = np.cross(before, after)
    sine, cosine = np.linalg.norm(axis), before @ after
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(axis / max(sine, 1e-300) * np.arctan2(sine, cosine))
    c2w = np.eye(4)
    c2w[:3, :3] = turn.as_matrix() @ camera.c2w[:3, :3]
    c2w[:3, 3] = place
    return replace(camera, c2w=c2w)
