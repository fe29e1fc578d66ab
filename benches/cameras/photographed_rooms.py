"""Pairs of photographs of procedural rooms under conditions that can be made hard one by one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import skimage.data

from benches.cameras.rendered_rooms import MIDDLE, RenderedRoom, encoded, looking, pinhole
from slgaussian.cameras.two_view import Photograph
from slgaussian.kernels.seeding import rng_for
from slgaussian.scene import Camera

WIDTH, HEIGHT = 576, 416

OVERSIZE = 1.3
"""Distorted photographs are taken from pictures of so many times the pixels a side."""

INVERTIBLE = 0.11
"""Most that distortion may shorten a radius, over the square of the largest: a lens is monotone."""

OBJECT_PHOTOS = ("coffee", "chelsea", "astronaut", "rocket")
OBJECT_SHARE = 0.025
"""Of the image, that one moved object covers."""


@dataclass(frozen=True)
class Conditions:
    """How a pair is photographed; as it stands, easily.

    Attributes
    ----------
    focal : float
        Of the first photograph, over the longer side.
    other_focal : float
        Of the second, over the first's.
    told : bool
        Whether it is told that the two lenses differ, as EXIF does.
    k1 : float
        First radial distortion, OpenCV's.
    roll : float
        Degrees that the second camera is turned about its axis.
    stops : float
        By which the second is darker; its contrast changes as well.
    blur : float
        Pixels that the second moves while it is exposed.
    noise : float
        Standard deviation, fraction of full scale.
    quality : int
        Of JPEG.
    moved : float
        Share of the image covered by objects that are elsewhere in the second.
    """

    focal: float = 0.9
    other_focal: float = 1.0
    told: bool = True
    k1: float = 0.0
    roll: float = 3.0
    stops: float = 0.0
    blur: float = 0.0
    noise: float = 0.005
    quality: int = 95
    moved: float = 0.0


@dataclass(frozen=True, eq=False)
class Shot:
    """Two photographs and the cameras that took them, their distortion left out."""

    photographs: tuple[Photograph, Photograph]
    cameras: tuple[Camera, Camera]


def shoot(seed: int, how: Conditions) -> Shot:
    """A pair by a seed, which decides the room and where the cameras stand, and its conditions."""
    cameras = _cameras(seed, how)
    rng = rng_for(seed, "photographed rooms", "noise")
    light = [_light(seed, _key(camera), how.k1) for camera in cameras]
    images = [encoded(light[0]), encoded(light[1] * 2.0**-how.stops) ** (1 + 0.15 * how.stops)]
    images = _with_objects(images, how.moved, rng_for(seed, "photographed rooms", "objects"))
    if how.blur:
        images[1] = _moved(images[1], how.blur, rng.uniform(0, np.pi))
    noisy = [image + rng.normal(0, how.noise, image.shape) for image in images]
    whole = [np.uint8(255 * np.clip(image, 0, 1) + 0.5) for image in noisy]
    lenses = ("a", "b") if how.told and how.other_focal != 1 else ("", "")
    a, b = (
        Photograph(name, _jpeg(image, how.quality), WIDTH, HEIGHT, lens)
        for name, image, lens in zip("ab", whole, lenses, strict=True)
    )
    return Shot((a, b), cameras)


def mixed(seed: int) -> Conditions:
    """Conditions drawn by a seed, all of them hard to some degree."""
    rng = rng_for(seed, "photographed rooms", "conditions")
    focal = float(np.exp(rng.uniform(np.log(0.5), np.log(2.5))))
    two = rng.random() < 0.3
    return Conditions(
        focal=focal,
        other_focal=float(np.exp(rng.uniform(np.log(0.7), np.log(1.4)))) if two else 1.0,
        k1=float(rng.uniform(-0.15, 0.1)),
        roll=float(rng.normal(0, 10)),
        stops=float(rng.uniform(0, 1.5)),
        blur=float(rng.uniform(0, 4)),
        noise=float(rng.uniform(0.005, 0.03)),
        quality=int(rng.integers(50, 96)),
        moved=float(rng.choice([0, 0.05, 0.1, 0.2])),
    )


def _cameras(seed: int, how: Conditions) -> tuple[Camera, Camera]:
    rng = rng_for(seed, "photographed rooms", "cameras")
    half = rng.uniform(0.12, 0.4)
    eyes = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-3.4, -2.4), rng.uniform(1.1, 1.7)])
    eyes = eyes + np.array([[-half, 0, 0], [half, 0, 0]]) + rng.normal(0, 0.1, (2, 3))
    targets = MIDDLE + rng.normal(0, 0.12, (2, 3))
    focal = how.focal * WIDTH
    first = pinhole(focal, WIDTH, HEIGHT, looking(eyes[0], targets[0], rng.normal(0, 2)))
    pose = looking(eyes[1], targets[1], how.roll)
    return first, pinhole(focal * how.other_focal, WIDTH, HEIGHT, pose)


def _key(camera: Camera) -> tuple[float, bytes]:
    return camera.K[0, 0], camera.c2w.tobytes()


@lru_cache(maxsize=16)  # most conditions change a photograph after it is taken
def _light(seed: int, key: tuple[float, bytes], k1: float) -> np.ndarray:
    focal, pose = key
    c2w = np.frombuffer(pose).reshape(4, 4)
    if k1 == 0:
        return _room(seed).light(pinhole(focal, WIDTH, HEIGHT, c2w))
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    seen = np.stack([x - WIDTH / 2, y - HEIGHT / 2], -1) / focal
    radius = np.linalg.norm(seen, axis=-1)
    k1 = max(k1, -INVERTIBLE / radius.max() ** 2)
    ideal = radius.copy()
    for _ in range(50):  # radius = ideal (1 + k1 ideal^2)
        ideal = radius / (1 + k1 * ideal**2)
    straight = seen * (ideal / np.maximum(radius, 1e-12))[..., None]
    scale = OVERSIZE * focal
    size = [2 * int(np.ceil(scale * np.abs(straight[..., i]).max() + 2)) for i in (0, 1)]
    large = _room(seed).light(pinhole(scale, *size, c2w))
    at = (straight * scale + np.array(size) / 2 - 0.5).astype(np.float32)
    return cv2.remap(large.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_AREA)


@lru_cache(maxsize=4)
def _room(seed: int) -> RenderedRoom:
    return RenderedRoom.of(seed)


def _with_objects(
    images: list[np.ndarray], share: float, rng: np.random.Generator
) -> list[np.ndarray]:
    """The images with round things in them that stand at another place in each."""
    out = [image.copy() for image in images]
    for _ in range(round(share / OBJECT_SHARE)):
        radius = round(np.sqrt(OBJECT_SHARE * WIDTH * HEIGHT / np.pi))
        side = 2 * radius + 1
        photo = getattr(skimage.data, str(rng.choice(OBJECT_PHOTOS)))()
        cut = min(photo.shape[:2]) // 2
        top, left = (rng.integers(0, size - cut + 1) for size in photo.shape[:2])
        photo = cv2.resize(photo[top : top + cut, left : left + cut], (side, side)) / 255
        y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
        round_ = (x**2 + y**2 <= radius**2)[..., None]
        for image in out:
            row, column = rng.integers(0, HEIGHT - side + 1), rng.integers(0, WIDTH - side + 1)
            window = np.s_[row : row + side, column : column + side]
            image[window] = np.where(round_, photo, image[window])
    return out


def _moved(image: np.ndarray, length: float, angle: float) -> np.ndarray:
    """The mean of the image over a straight way of that many pixels."""
    steps = np.linspace(-0.5, 0.5, 4 * int(np.ceil(length)) + 1) * length
    total = np.zeros_like(image)
    for step in steps:
        shift = np.array([[1, 0, step * np.cos(angle)], [0, 1, step * np.sin(angle)]])
        total += cv2.warpAffine(image, shift, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    return total / len(steps)


def _jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    _, packed = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.ascontiguousarray(cv2.imdecode(packed, cv2.IMREAD_COLOR)[..., ::-1])


EASY = Conditions()
FACTORS: dict[str, tuple[str, dict[float, Conditions]]] = {
    "focal": (
        "over the longer side",
        {v: replace(EASY, focal=v) for v in (0.5, 0.7, 0.9, 1.3, 1.8, 2.5)},
    ),
    "focals differ": (
        "second over first, lenses told",
        {v: replace(EASY, other_focal=v) for v in (1.1, 1.25, 1.5, 2.0)},
    ),
    "focals differ, unsaid": (
        "second over first",
        {v: replace(EASY, other_focal=v, told=False) for v in (1.1, 1.25, 1.5, 2.0)},
    ),
    "distortion": ("k1", {v: replace(EASY, k1=v) for v in (-0.15, -0.08, -0.03, 0.05, 0.1)}),
    "roll": ("degrees", {v: replace(EASY, roll=v) for v in (10.0, 30.0, 60.0, 90.0)}),
    "exposure": ("stops", {v: replace(EASY, stops=v) for v in (0.5, 1.0, 2.0, 3.0)}),
    "motion blur": ("pixels", {v: replace(EASY, blur=v) for v in (2.0, 4.0, 8.0, 16.0)}),
    "noise": ("of full scale", {v: replace(EASY, noise=v) for v in (0.02, 0.04, 0.08, 0.16)}),
    "JPEG": ("quality", {v: replace(EASY, quality=int(v)) for v in (80.0, 50.0, 30.0, 10.0)}),
    "moving things": (
        "share of the image",
        {v: replace(EASY, moved=v) for v in (0.05, 0.1, 0.2, 0.4)},
    ),
}
"""By factor: what its levels say, and the conditions at each level."""
