"""Pairs of photographs that camera estimation must refuse, by their flaw, and two good pairs."""

from functools import cache

import cv2
import numpy as np
import skimage.data
from scipy.spatial.transform import Rotation

from slgaussian.cameras.two_view import Photograph
from tests.cameras.rendered_rooms import RenderedRoom, encode_srgb, looking, pinhole

WIDTH, HEIGHT = 640, 480
FOCAL = 0.9 * WIDTH
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])


def photographs(*images: np.ndarray) -> list[Photograph]:
    return [
        Photograph(f"{name}.jpg", image, image.shape[1], image.shape[0])
        for name, image in zip("ab", images, strict=True)
    ]


@cache
def motorcycle() -> tuple[np.ndarray, np.ndarray]:
    left, right, _ = skimage.data.stereo_motorcycle()
    return left, right


@cache
def room(seed: int, x: float, yaw: float = 0.0) -> np.ndarray:
    """Render a room from ``x`` metres right of its middle, turned right by degrees."""
    c2w = looking(np.array([x, -3.1, 1.4]))
    c2w[:3, :3] = c2w[:3, :3] @ rotation(y=yaw)
    light = RenderedRoom.of(seed).light(pinhole(0.9 * 480, 480, 360, c2w))
    return with_noise(255 * encode_srgb(light), 100 + round(50 * x) + round(yaw))


def rotation(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return a rotation [3, 3] by degrees about the axes x, then y, then z."""
    return Rotation.from_euler("xyz", (x, y, z), degrees=True).as_matrix()


def render_plane(texture: np.ndarray, scale: float, R: np.ndarray, center, z=3.0) -> np.ndarray:
    """Render a texture at depth ``z``, float32 [480, 640, C].

    Its middle is on the z axis, and ``scale`` of its pixels are a unit. ``R`` is camera-to-world.
    """
    height, width = texture.shape[:2]
    to_world = [[1 / scale, 0, -width / 2 / scale], [0, 1 / scale, -height / 2 / scale], [0, 0, z]]
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV counts pixel centres at 0
    H = np.linalg.inv(half) @ K @ R.T @ (to_world - np.outer(center, (0, 0, 1))) @ half
    return cv2.warpPerspective(texture.astype(np.float32), H, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)


def with_noise(image: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.uint8(np.clip(image + rng.normal(0, 2, image.shape), 0, 255) + 0.5)


def poster(R: np.ndarray, center: tuple[float, float, float], seed: int) -> np.ndarray:
    """Render a flat picture that fills the view."""
    flat = cv2.resize(motorcycle()[0], None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    return with_noise(render_plane(flat, 370, R, center), seed)


def facade(R: np.ndarray, center: tuple[float, float, float], seed: int) -> np.ndarray:
    """Render a wall of equal windows a metre apart, whose panes lie .25 behind it."""
    rng = np.random.default_rng(5)
    size, tiles = 160, 17

    def tile(base: float, spread: float) -> np.ndarray:
        coarse = rng.normal(0, spread, (20, 20, 3))
        fine = cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
        return np.tile(base + fine, (tiles, tiles, 1))

    hole = np.zeros((size, size))
    hole[40:130, 35:125] = 1
    hole[82:88, :] = 0
    wall, panes = tile(170, 25), tile(90, 35)
    near = render_plane(np.dstack([wall, np.tile(hole, (tiles, tiles))]), size, R, center, 4.0)
    through = near[..., 3:]
    far = render_plane(panes, size, R, center, 4.25)
    return with_noise(near[..., :3] * (1 - through) + far * through, seed)


def motorcycle_pair() -> list[Photograph]:
    return photographs(*motorcycle())


def room_pair() -> list[Photograph]:
    return photographs(room(5, -0.3), room(5, 0.3))


def _other_exposure() -> list[Photograph]:
    left, _ = motorcycle()
    darker = 255 * (0.75 * left / 255) ** 1.4
    _, jpeg = cv2.imencode(".jpg", with_noise(darker, 1), [cv2.IMWRITE_JPEG_QUALITY, 85])
    return photographs(left, cv2.imdecode(jpeg, cv2.IMREAD_COLOR))


def _plane() -> list[Photograph]:
    return photographs(
        poster(rotation(x=5, y=12), (-0.6, 0.0, 0.0), 2),
        poster(rotation(y=-10, z=4), (0.6, 0.1, 0), 3),
    )


def _common_corner() -> list[Photograph]:
    """Return a photograph, and one that has a part of it in a corner, as on a screen."""
    left, right = motorcycle()
    cat = cv2.resize(skimage.data.chelsea(), left.shape[1::-1], interpolation=cv2.INTER_AREA)
    cat[20:190, 30:230] = right[200:370, 250:450]
    return photographs(left, cat)


def _facade() -> list[Photograph]:
    """Move the second camera by more than a window's width."""
    return photographs(
        facade(rotation(y=3), (-0.55, 0.0, 0.0), 4), facade(rotation(y=-3), (0.55, 0.0, 0.5), 5)
    )


def _blur() -> list[Photograph]:
    return photographs(*(cv2.GaussianBlur(room(5, x), (0, 0), 7) for x in (-0.3, 0.3)))


REFUSED = {
    "same photograph": (lambda: photographs(*[motorcycle()[0]] * 2), "same picture as"),
    "other exposure": (_other_exposure, "same picture as"),
    "pure rotation": (lambda: photographs(room(5, 0.0), room(5, 0.0, yaw=9.0)), "sideways"),
    "plane": (_plane, "flat"),
    "blur": (_blur, "blur|few|found"),
    "common corner": (_common_corner, "part|few"),
    "two rooms": (lambda: photographs(room(3, -0.3), room(5, 0.3)), "overlap|place|few|found"),
    "repeated windows": (_facade, "repeat|flat"),
    "black": (lambda: photographs(motorcycle()[0], np.zeros((480, 640, 3), np.uint8)), "is black"),
    "blank": (lambda: photographs(motorcycle()[0], np.full((480, 640, 3), 250, np.uint8)), "blank"),
    "tiny": (lambda: photographs(*(i[::45, ::45].copy() for i in motorcycle())), "17x12 pixels"),
}
"""By flaw: a function that makes the photographs, and a regular expression of the refusal."""
