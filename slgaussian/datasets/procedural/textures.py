"""Textures of surfaces: patterns, solid noise, and the photographs in scikit-image.

A pattern consists of *cells* on the surface of a solid, an integer number of them around a round
solid, so that stripes, checks and dots have no seam. Colours are linear light in [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
import skimage.data

from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, RING
from slgaussian.formats.colour import decode_srgb
from slgaussian.kernels.jit import kernel

PLAIN, STRIPED, CHECKED, DOTTED, SPECKLED, WOODEN, MARBLE, BRICK, PHOTO, PICTURE = range(10)

PHOTOS = ("gravel", "grass", "coffee", "chelsea", "astronaut", "rocket")
"""Photographs in the scikit-image wheel, as named in ``skimage.data``; the first two are grey
close-ups of a material, tinted by the colour of the object."""

PHOTO_SIZE = 256
FRAME = 0.06  # width of a picture's frame, as a fraction of the picture


RGB = tuple[float, float, float]  # red, green and blue


@dataclass(frozen=True)
class Material:
    """A material of an object.

    Attributes:
        pattern: One of the constants of this module.
        first, second: tuple of float. Linear RGB in [0, 1]: the main colour and that of every other
            stripe, check, dot or vein.
        cell: Size of a pattern cell (a stripe, a photograph's tile, a plank) in scene units.
        photo: For PHOTO and PICTURE, one of ``PHOTOS``.
        gloss: Strength of the specular highlight, 0 to 1.
    """

    pattern: int
    first: RGB
    second: RGB = (0.8, 0.8, 0.8)
    cell: float = 0.1
    photo: str = PHOTOS[0]
    gloss: float = 0.05


class Materials(NamedTuple):
    """Materials as arrays for compiled loops, one row per solid, and pixels of the photographs."""

    pattern: np.ndarray  # int64 [P]
    first: np.ndarray  # float64 [P, 3]
    second: np.ndarray  # float64 [P, 3]
    cell: np.ndarray  # float64 [P]
    photo: np.ndarray  # int64 [P]
    gloss: np.ndarray  # float64 [P]
    offset: np.ndarray  # float64 [P, 3]: offset of the solid in the noise
    photos: np.ndarray  # float64 [len(PHOTOS), PHOTO_SIZE, PHOTO_SIZE, 3], linear


def pack(materials: Sequence[Material], rng: np.random.Generator) -> Materials:
    """Pack one material per solid; ``rng`` draws an offset in the noise for each."""
    return Materials(
        pattern=np.array([m.pattern for m in materials], np.int64),
        first=np.array([m.first for m in materials], np.float64),
        second=np.array([m.second for m in materials], np.float64),
        cell=np.array([m.cell for m in materials], np.float64),
        photo=np.array([PHOTOS.index(m.photo) for m in materials], np.int64),
        gloss=np.array([m.gloss for m in materials], np.float64),
        offset=rng.uniform(-50, 50, (len(materials), 3)),
        photos=_photos(),
    )


@cache
def _photos() -> np.ndarray:
    out = []
    for name in PHOTOS:
        image = getattr(skimage.data, name)()
        side = min(image.shape[:2])
        top, left = (image.shape[0] - side) // 2, (image.shape[1] - side) // 2
        image = image[top : top + side, left : left + side]
        small = cv2.resize(image, (PHOTO_SIZE, PHOTO_SIZE), interpolation=cv2.INTER_AREA)
        values = decode_srgb(small / 255.0)
        if values.ndim == 2:  # a material: divided by its mean, so that the tint sets the colour
            values = np.repeat((values / values.mean())[..., None], 3, axis=-1)
        out.append(values)
    return np.stack(out)


@kernel
def albedo(materials, p, kind, size, point, normal):
    """Return the linear RGB of solid ``p`` at a local surface point with local outward normal."""
    pattern = materials.pattern[p]
    first, second = materials.first[p], materials.second[p]
    cell, cut = materials.cell[p], materials.offset[p]
    x, y, z = point
    ox, oy, oz = x + cut[0], y + cut[1], z + cut[2]
    u, v = _surface(kind, size, point, normal, cell, pattern == DOTTED)
    # Real surfaces are uneven: add coarse and fine noise, much weaker than any pattern.
    tone = (
        1.0 + 0.10 * _clouds(ox * 7, oy * 7, oz * 7, 2) + 0.12 * _noise(ox * 70, oy * 70, oz * 70)
    )
    mix = 0.0
    if pattern == STRIPED:
        mix = math.floor(u if kind == RING else v) % 2
    elif pattern == CHECKED:
        mix = (math.floor(u) + math.floor(v)) % 2
    elif pattern == DOTTED:
        du, dv = u - math.floor(u) - 0.5, v - math.floor(v) - 0.5
        mix = 1.0 if du * du + dv * dv < 0.09 else 0.0
    elif pattern == SPECKLED:
        fleck = _noise(ox / cell, oy / cell, oz / cell)
        mix = _ramp(fleck, 0.22, 0.30)
        tone *= 1.0 - 0.6 * _ramp(-fleck, 0.24, 0.32)
    elif pattern == WOODEN:
        plank = math.floor(oy / cell)
        gap = _ramp(abs(oy / cell - plank - 0.5), 0.455, 0.475)
        tone *= 1.0 + 0.25 * _hash(plank, 7, 3) - 0.45 * gap
        warp = _clouds(ox * 1.5, oy * 6 + plank * 9.1, oz * 6, 3)
        ring = math.sin((oy + oz) * 45 + plank * 2.4 + warp * 14)
        fibre = _noise(ox * 12, oy * 160, oz * 160)
        mix = 0.5 + 0.33 * ring + 0.3 * fibre
    elif pattern == MARBLE:
        warp = _clouds(ox * 4, oy * 4, oz * 4, 4)
        vein = abs(math.sin(((ox + 0.6 * oy + 0.4 * oz) / cell + warp * 1.6) * math.pi))
        mix = 0.75 * (1.0 - vein) ** 4 + 0.6 * max(0.0, -warp)
    elif pattern == BRICK:
        course = math.floor(v)
        along = u / 3 + 0.5 * (course % 2)
        brick = math.floor(along)
        edge = min(0.5 - abs(v - course - 0.5), 3 * (0.5 - abs(along - brick - 0.5)))
        mix = 1.0 - _ramp(edge, 0.05, 0.09)
        tone *= 1.0 + (1.0 - mix) * 0.5 * _hash(course, brick, 5)
    elif pattern == PHOTO:
        r, g, b = _sample(materials.photos[materials.photo[p]], u, v)
        return r * first[0], g * first[1], b * first[2]
    elif pattern == PICTURE:
        rim = FRAME * min(size[0], size[2])
        if normal[1] < 0 and abs(x) < size[0] - 2 * rim and abs(z) < size[2] - 2 * rim:
            u, v = 0.5 + 0.5 * x / size[0], 0.5 + 0.5 * z / size[2]
            return _sample(materials.photos[materials.photo[p]], u, v)
    mix = min(max(mix, 0.0), 1.0)
    return (
        tone * (first[0] + mix * (second[0] - first[0])),
        tone * (first[1] + mix * (second[1] - first[1])),
        tone * (first[2] + mix * (second[2] - first[2])),
    )


@kernel
def _surface(kind, size, point, normal, cell, rows):
    """Return the position of a local surface point in the grid of pattern cells: along, up.

    With ``rows`` each row of a ball or cone has as many cells as fit around it, so that dots are
    round; without, every row has the same even number, so that checks are continuous.
    """
    x, y, z = point
    if kind == BOX:
        if abs(normal[0]) > 0.5:
            return _fit(y, size[1], cell), _fit(z, size[2], cell)
        if abs(normal[1]) > 0.5:
            return _fit(x, size[0], cell), _fit(z, size[2], cell)
        return _fit(x, size[0], cell), _fit(y, size[1], cell)
    turn, radius = 0.5 + math.atan2(y, x) / (2 * math.pi), size[0]
    if kind == RING:
        tube_angle = math.atan2(z, math.hypot(x, y) - radius) / (2 * math.pi) + 0.5
        along = turn * _even(2 * math.pi * radius / cell)
        return along, tube_angle * _even(2 * math.pi * size[1] / cell)
    if (kind == CYLINDER and abs(normal[2]) > 0.5) or (kind == CONE and normal[2] < -0.5):
        return _fit(x, radius, cell), _fit(y, radius, cell)
    count = _even(2 * math.pi * radius / cell)
    if kind == BALL:
        latitudes = max(2.0, round(math.pi * radius / cell))
        v = (math.asin(min(1.0, max(-1.0, z / radius))) / math.pi + 0.5) * latitudes
        if rows:
            middle = ((math.floor(v) + 0.5) / latitudes - 0.5) * math.pi
            count = max(1.0, round(2 * latitudes * math.cos(middle)))
        return turn * count, v
    v = _fit(z, size[1], cell)
    if kind == CONE and rows:
        fraction = (math.floor(v) + 0.5) / max(1.0, round(2 * size[1] / cell))
        count = max(1.0, round(2 * math.pi * radius * (1 - fraction) / cell))
    return turn * count, v


@kernel
def _fit(x, half, cell):
    return (x + half) / (2 * half) * max(1.0, round(2 * half / cell))


@kernel
def _even(count):
    return 2 * max(1.0, round(count / 2))


@kernel
def _ramp(x, lo, hi):
    return min(max((x - lo) / (hi - lo), 0.0), 1.0)


@kernel
def _sample(photo, u, v):
    """Sample a photograph bilinearly; tiles are mirrored at integer u and v; v points up."""
    side = photo.shape[0]
    u, v = abs((u + 1) % 2 - 1), 1 - abs((v + 1) % 2 - 1)
    col = min(max(u * side - 0.5, 0.0), side - 1.001)
    row = min(max(v * side - 0.5, 0.0), side - 1.001)
    j, i = int(col), int(row)
    a, b = col - j, row - i
    top = photo[i, j] * (1 - a) + photo[i, j + 1] * a
    low = photo[i + 1, j] * (1 - a) + photo[i + 1, j + 1] * a
    return (
        top[0] * (1 - b) + low[0] * b,
        top[1] * (1 - b) + low[1] * b,
        top[2] * (1 - b) + low[2] * b,
    )


@kernel
def _hash(i, j, k):
    """Return a pseudo-random number in [-0.5, 0.5) of a lattice point (integer mixing, 32 bit)."""
    h = (int(i) * 374761393 + int(j) * 668265263 + int(k) * 2654435761) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 1911520717) & 0xFFFFFFFF
    return (h ^ (h >> 15)) / 4294967296.0 - 0.5


@kernel
def _noise(x, y, z):
    """Interpolate hashed lattice values smoothly: noise in [-0.5, 0.5] with unit cells."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    a, b, c = x - i, y - j, z - k
    a, b, c = a * a * (3 - 2 * a), b * b * (3 - 2 * b), c * c * (3 - 2 * c)
    near = (1 - b) * (_hash(i, j, k) * (1 - a) + _hash(i + 1, j, k) * a) + b * (
        _hash(i, j + 1, k) * (1 - a) + _hash(i + 1, j + 1, k) * a
    )
    far = (1 - b) * (_hash(i, j, k + 1) * (1 - a) + _hash(i + 1, j, k + 1) * a) + b * (
        _hash(i, j + 1, k + 1) * (1 - a) + _hash(i + 1, j + 1, k + 1) * a
    )
    return (1 - c) * near + c * far


@kernel
def _clouds(x, y, z, octaves):
    """Sum ``octaves`` of noise, each twice as fine and half as strong."""
    total, strength = 0.0, 1.0
    for _ in range(octaves):
        total += strength * _noise(x, y, z)
        x, y, z, strength = 2.03 * x, 2.03 * y, 2.03 * z, 0.5 * strength
    return total
