"""Shading of a room: Lambertian and specular reflection, one area light, shadows, anti-aliasing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slgaussian.datasets.procedural.raycast import Solids, dot, nearest, normal_at, rotate
from slgaussian.datasets.procedural.textures import Materials, albedo
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.scene import Camera

SAMPLES = 2
"""Rays per pixel side; each of the SAMPLES**2 rays samples SAMPLES**2 points of the light."""

_SHADOW_OFFSET = 1e-5  # shadow rays start this far above the surface, in scene units


class Light(NamedTuple):
    """A square lamp facing down: ``centre`` float64 [3], half side, and linear intensities.

    ``power`` is the irradiance of a surface facing the lamp at distance ``reach``; ``ambient`` is
    the irradiance from all other directions, stronger from above than from below.
    """

    centre: np.ndarray
    half: float
    power: float
    reach: float
    ambient: float


def photograph(
    solids: Solids, casters: Solids, materials: Materials, light: Light, camera: Camera
) -> np.ndarray:
    """Render the linear-light image float64 [H, W, 3] (unclipped) of the solids.

    ``casters`` are the solids that may cast shadows: walls around a lamp cannot, and leaving them
    out saves most of the time. Pixels without a hit are black.
    """
    image = np.empty((camera.height, camera.width, 3))
    to_world = camera.c2w[:3, :3] @ np.linalg.inv(camera.K)
    scene = solids, casters, materials, light
    share(_photograph, len(image), *scene, camera.center.copy(), to_world, image)
    return image


@kernel
def _photograph(counter, solids, casters, materials, light, eye, to_world, image):
    n, row = SAMPLES, take(counter)
    origin = (eye[0], eye[1], eye[2])
    while row < len(image):
        for col in range(image.shape[1]):
            red, green, blue = 0.0, 0.0, 0.0
            for k in range(n * n):
                pixel = (col + (k % n + 0.5) / n, row + (k // n + 0.5) / n, 1.0)
                ray = rotate(to_world, pixel)
                r, g, b = _radiance(solids, casters, materials, light, origin, ray, k)
                red, green, blue = red + r, green + g, blue + b
            image[row, col, 0] = red / (n * n)
            image[row, col, 1] = green / (n * n)
            image[row, col, 2] = blue / (n * n)
        row = take(counter)


@kernel
def _radiance(solids, casters, materials, light, eye, ray, sample):
    t, p = nearest(solids, eye, ray, np.inf)
    if p < 0:
        return 0.0, 0.0, 0.0
    px, py, pz = eye[0] + t * ray[0], eye[1] + t * ray[1], eye[2] + t * ray[2]
    a, c = solids.to_local[p], solids.centre[p]
    local = rotate(a, (px - c[0], py - c[1], pz - c[2]))
    kind, size = solids.kind[p], solids.size[p]
    normal = normal_at(kind, size, local)
    red, green, blue = albedo(materials, p, kind, size, local, normal)
    nx, ny, nz = rotate(a.T, normal)

    # Ambient light is stronger from the ceiling than from the floor, and slightly weaker from one
    # side, so that the faces of a box differ also in the shadow.
    diffuse = light.ambient * (0.75 + 0.25 * nz + 0.06 * nx)
    shine = 0.0
    length = math.sqrt(dot(ray, ray))
    lifted = (px + _SHADOW_OFFSET * nx, py + _SHADOW_OFFSET * ny, pz + _SHADOW_OFFSET * nz)
    n = SAMPLES
    for k in range(n * n):
        # The n^4 points of the lamp form one grid; each sub-pixel samples n^2 of them.
        gx = ((k % n) * n + sample % n + 0.5) / (n * n) * 2 - 1
        gy = ((k // n) * n + sample // n + 0.5) / (n * n) * 2 - 1
        vx = light.centre[0] + light.half * gx - px
        vy = light.centre[1] + light.half * gy - py
        vz = light.centre[2] - pz
        to_lamp = (vx, vy, vz)
        d2 = dot(to_lamp, to_lamp)
        d = math.sqrt(d2)
        facing = dot((nx, ny, nz), to_lamp) / d
        if facing <= 0 or nearest(casters, lifted, to_lamp, 1.0)[1] >= 0:
            continue
        # The light of a lamp decreases more slowly in a room, because walls reflect it.
        strength = light.power / (n * n) * 2 / (1 + d2 / light.reach**2)
        diffuse += strength * facing
        half = (vx / d - ray[0] / length, vy / d - ray[1] / length, vz / d - ray[2] / length)
        cosine = dot((nx, ny, nz), half) / max(math.sqrt(dot(half, half)), 1e-12)
        shine += strength * max(cosine, 0.0) ** 40
    shine *= materials.gloss[p]
    return red * diffuse + shine, green * diffuse + shine, blue * diffuse + shine
