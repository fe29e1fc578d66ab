"""Pairs of photographs from which no cameras can be found, by their flaw, and two good pairs."""

from functools import cache

import cv2
import numpy as np
import skimage.data
from scipy.spatial.transform import Rotation

from slgaussian.cameras.two_view import Photograph
from tests.cameras.rendered_rooms import RenderedRoom, encoded, looking, pinhole

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
    """A procedural room from ``x`` metres right of its middle, turned by degrees to the right."""
    c2w = looking(np.array([x, -3.1, 1.4]))
    c2w[:3, :3] = c2w[:3, :3] @ turned(y=yaw)
    light = RenderedRoom.of(seed).light(pinhole(0.9 * 480, 480, 360, c2w))
    return with_noise(255 * encoded(light), 100 + round(50 * x) + round(yaw))


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A rotation [3, 3] by degrees about the axes x, then y, then z."""
    return Rotation.from_euler("xyz", (x, y, z), degrees=True).as_matrix()


def of_plane(texture: np.ndarray, metre: float, R: np.ndarray, at, z: float = 3.0) -> np.ndarray:
    """A poster as a camera with pose ``R`` (to world) and ``at`` shows it, float32 [480, 640, C].

    The poster hangs at depth ``z``, its middle on the z axis, ``metre`` of its pixels a unit.
    """
    height, width = texture.shape[:2]
    lay = [[1 / metre, 0, -width / 2 / metre], [0, 1 / metre, -height / 2 / metre], [0, 0, z]]
    centre = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV counts centres at 0
    H = np.linalg.inv(centre) @ K @ R.T @ (lay - np.outer(at, (0, 0, 1))) @ centre
    return cv2.warpPerspective(texture.astype(np.float32), H, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)


def with_noise(image: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.uint8(np.clip(image + rng.normal(0, 2, image.shape), 0, 255) + 0.5)


def poster(R: np.ndarray, at: tuple[float, float, float], seed: int) -> np.ndarray:
    """A flat picture that fills what a camera sees."""
    flat = cv2.resize(motorcycle()[0], None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    return with_noise(of_plane(flat, 370, R, at), seed)


def facade(R: np.ndarray, at: tuple[float, float, float], seed: int) -> np.ndarray:
    """A wall with windows a metre apart, all alike, whose panes lie .25 behind it."""
    rng = np.random.default_rng(5)
    size, tiles = 160, 17

    def tiled(base: float, spread: float) -> np.ndarray:
        coarse = rng.normal(0, spread, (20, 20, 3))
        fine = cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
        return np.tile(base + fine, (tiles, tiles, 1))

    hole = np.zeros((size, size))
    hole[40:130, 35:125] = 1
    hole[82:88, :] = 0
    wall, panes = tiled(170, 25), tiled(90, 35)
    near = of_plane(np.dstack([wall, np.tile(hole, (tiles, tiles))]), size, R, at, 4.0)
    through = near[..., 3:]
    far = of_plane(panes, size, R, at, 4.25)
    return with_noise(near[..., :3] * (1 - through) + far * through, seed)


def bikes() -> list[Photograph]:
    return photographs(*motorcycle())


def a_room() -> list[Photograph]:
    return photographs(room(5, -0.3), room(5, 0.3))


def _exposure() -> list[Photograph]:
    left, _ = motorcycle()
    darker = 255 * (0.75 * left / 255) ** 1.4
    _, jpeg = cv2.imencode(".jpg", with_noise(darker, 1), [cv2.IMWRITE_JPEG_QUALITY, 85])
    return photographs(left, cv2.imdecode(jpeg, cv2.IMREAD_COLOR))


def _plane() -> list[Photograph]:
    return photographs(
        poster(turned(x=5, y=12), (-0.6, 0.0, 0.0), 2), poster(turned(y=-10, z=4), (0.6, 0.1, 0), 3)
    )


def _clustered() -> list[Photograph]:
    """A part of one photograph stands in the corner of another, as on a screen."""
    left, right = motorcycle()
    cat = cv2.resize(skimage.data.chelsea(), left.shape[1::-1], interpolation=cv2.INTER_AREA)
    cat[20:190, 30:230] = right[200:370, 250:450]
    return photographs(left, cat)


def _facade() -> list[Photograph]:
    """The second camera has moved by a window's width, and then some."""
    return photographs(
        facade(turned(y=3), (-0.55, 0.0, 0.0), 4), facade(turned(y=-3), (0.55, 0.0, 0.5), 5)
    )


def _blurred() -> list[Photograph]:
    """Two views of a room, all but lost in blur."""
    return photographs(*(cv2.GaussianBlur(room(5, x), (0, 0), 7) for x in (-0.3, 0.3)))


REFUSED = {
    "one photograph twice": (lambda: photographs(*[motorcycle()[0]] * 2), "one place"),
    "another exposure": (_exposure, "one place"),
    "a pure rotation": (lambda: photographs(room(5, 0.0), room(5, 0.0, yaw=9.0)), "sideways"),
    "a plane": (_plane, "flat"),
    "a blurred pair": (_blurred, "blur|few|found"),
    "one corner in common": (_clustered, "part|few"),
    "two places": (lambda: photographs(room(3, -0.3), room(5, 0.3)), "overlap|place|few|found"),
    "a repeated facade": (_facade, "repeat|flat"),
}
"""By name: what makes the two photographs, and what the refusal says, a regular expression."""
