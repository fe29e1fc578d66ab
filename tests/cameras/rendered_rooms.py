"""Procedural rooms rendered for any camera: photographs with exact cameras and depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slgaussian.datasets.procedural import raycast
from slgaussian.datasets.procedural.rooms import FOCUS, Room, furnish
from slgaussian.datasets.procedural.shading import photograph
from slgaussian.datasets.procedural.textures import Materials
from slgaussian.kernels.seeding import rng_for
from slgaussian.scene import Camera


@dataclass(frozen=True, eq=False)
class RenderedRoom:
    """A room with its materials; z is up, units are metres."""

    room: Room
    materials: Materials

    @staticmethod
    def of(seed: int) -> RenderedRoom:
        name = f"rendered_{seed}"
        # Furnished for two small views, as by the reader of the data set.
        ends = [pinhole(65, 72, 52, looking(FOCUS + [x, -3.3, 0.95])) for x in (-0.3, 0.3)]
        room = furnish(rng_for(seed, name, "room"), 10, ends)
        return RenderedRoom(room, room.materials(rng_for(seed, name, "materials")))

    def light(self, camera: Camera) -> np.ndarray:
        """Render linear light float64 [H, W, 3], about 0 to 1."""
        solids, casters = self.room.solids(), self.room.solids(casters=True)
        return photograph(solids, casters, self.materials, self.room.light, camera)

    def depth(self, camera: Camera) -> np.ndarray:
        """Render depths along z, float32 [H, W], infinity where there is no surface."""
        t, _ = raycast.cast(self.room.solids(), camera.center, camera.rays())
        return t.astype(np.float32)


def looking(eye: np.ndarray, target: np.ndarray = FOCUS, roll: float = 0.0) -> np.ndarray:
    """Return camera-to-world [4, 4] at ``eye`` towards ``target``, rolled by degrees."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    c2w = np.eye(4)
    c2w[:3, :3] = np.stack([c * right + s * down, c * down - s * right, forward], 1)
    c2w[:3, 3] = eye
    return c2w


def pinhole(focal: float, width: int, height: int, c2w: np.ndarray) -> Camera:
    """Return a camera whose principal point is the middle of its image."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(K, c2w, width, height)


def encode_srgb(light: np.ndarray) -> np.ndarray:
    """Encode linear light, clipped, as sRGB in [0, 1] (IEC 61966-2-1)."""
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
