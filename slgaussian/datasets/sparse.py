"""Reading of a COLMAP sparse model: cameras, posed images and points, ``.bin`` or ``.txt``.

The formats are https://colmap.github.io/format.html; the newer files of rigs and frames repeat the
poses and are not needed. pycolmap reads these files too, but for a truncated file some versions
(such as 4.2.1) return arbitrary numbers, hang or end the process. Here every count is checked
against the remaining bytes of the file.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.text import read_lines

MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5),
    4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16), 12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6), 17: ("EQUIRECTANGULAR", 2),
}  # fmt: skip
"""Camera models: name and number of parameters by the id in binary files."""

KINDS = ("cameras", "images", "points3D")

IMAGE = re.compile(r"[ \t]*" + r"([^ \t]+)[ \t]+" * 8 + r"([^ \t]+)[ \t]?(.*)", re.DOTALL)
"""The line of an image in a text file: id, quaternion, translation, camera; the rest is its name.
"""

T = TypeVar("T")


@dataclass(frozen=True)
class SparseCamera:
    """Intrinsics of one camera: model name, size in pixels, parameters of the model."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class SparseImage:
    """One posed image: name of its file, id of its camera, world-to-camera float64 [4, 4]."""

    name: str
    camera: int
    w2c: np.ndarray


@dataclass(frozen=True, eq=False)
class SparseModel:
    """Content of the files of a model.

    Attributes:
        cameras: {id: SparseCamera}
        images: {id: SparseImage}
        points: float64 [P, 3]. World points, in scene units.
        sightings: int64 [M, 2]. Observations: row of the point in ``points``, and id of the image.
    """

    cameras: dict[int, SparseCamera]
    images: dict[int, SparseImage]
    points: np.ndarray
    sightings: np.ndarray


def model_files(folder: Path) -> list[Path]:
    """List the files of the model in a folder, all of one format; empty without cameras or images.

    Points may be missing: such a reconstruction still has poses.
    """
    for kind in (".bin", ".txt"):
        files = [folder / f"{name}{kind}" for name in KINDS]
        if files[0].is_file() and files[1].is_file():
            return [file for file in files if file.is_file()]
    return []


def count_images(folder: Path) -> int:
    """Count the posed images of the model in a folder; 0 if its file of images is damaged."""
    file = model_files(folder)[1]
    try:
        if file.suffix == ".txt":
            return len(_images(file))
        with file.open("rb") as stream:
            return struct.unpack("<Q", stream.read(8))[0]
    except (OSError, struct.error, _Wrong):
        return 0


def read_model(folder: Path) -> SparseModel:
    """Read the model in a folder; the binary files if both formats exist.

    Raises:
        InputError: If there is no model, or a file is truncated or invalid; the message names the
            file.
    """
    files = model_files(folder)
    if not files:
        raise InputError(
            f"{folder}: has no COLMAP model; expected cameras and images there, .bin or .txt"
        )
    cameras, images = _checked(files[0], _cameras), _checked(files[1], _images)
    points, sightings = np.zeros((0, 3)), np.zeros((0, 2), np.int64)
    if len(files) > 2:
        points, sightings = _checked(files[2], _points)
    for image in images.values():
        if image.camera not in cameras:
            raise InputError(
                f"{files[1]}: {image.name!r} was taken with camera {image.camera}, which "
                f"{files[0].name} does not have; the two files are not of one model"
            )
    return SparseModel(cameras, images, points, sightings)


def _checked(file: Path, read: Callable[[Path], T]) -> T:
    try:
        return read(file)
    except OSError as bad:
        raise InputError(f"{file}: cannot be read ({bad.strerror})") from None
    except _Wrong as bad:
        raise InputError(f"{file}: {bad}; it is damaged or cut short, copy it again") from None


class _Wrong(Exception):
    """A file is damaged; the message describes the problem."""


class _Bytes:
    """Sequential reader of a binary file that never reads past its end."""

    def __init__(self, file: Path):
        self.data = file.read_bytes()
        self.at = 0

    def take(self, layout: str) -> tuple:
        """Return the next values for a :mod:`struct` format."""
        start = self.skip(struct.calcsize(f"<{layout}"))
        return struct.unpack_from(f"<{layout}", self.data, start)

    def skip(self, count: int) -> int:
        """Skip ``count`` bytes; return the offset of the first."""
        start = self.at
        if count > len(self.data) - start:
            raise _Wrong(f"ends after {len(self.data)} bytes, in the middle of an entry")
        self.at += count
        return start

    def text(self) -> str:
        """Return the text up to the next zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise _Wrong("ends in the middle of a name")
        start, self.at = self.at, end + 1
        return self.data[start:end].decode("utf-8", "replace")

    def entries(self, min_bytes: int) -> Iterator[int]:
        """Yield the index of each entry; a count, checked against ``min_bytes`` each, precedes."""
        (count,) = self.take("Q")
        if count * min_bytes > len(self.data) - self.at:
            raise _Wrong(f"says that it has {count} entries, but ends after {len(self.data)} bytes")
        yield from range(count)
        if self.at != len(self.data):
            raise _Wrong(f"goes on for {len(self.data) - self.at} bytes after its last entry")


def _cameras(file: Path) -> dict[int, SparseCamera]:
    cameras: dict[int, SparseCamera] = {}
    counts = dict(MODELS.values())
    for number, model, width, height, params in _stored_cameras(file):
        if number in cameras:
            raise _Wrong(f"has two cameras {number}")
        if model not in counts:
            raise _Wrong(f"camera {number} is of model {model}, which is not known")
        if len(params) != counts[model]:
            raise _Wrong(
                f"camera {number}: {model} has {counts[model]} parameters, found {len(params)}"
            )
        if not (0 < width < 1e6 and 0 < height < 1e6 and np.isfinite(params).all()):
            raise _Wrong(f"camera {number} is {width}x{height} pixels with parameters {params}")
        cameras[number] = SparseCamera(model, width, height, params)
    return cameras


def _stored_cameras(file: Path) -> Iterator[tuple[int, str, int, int, tuple[float, ...]]]:
    """Yield id, model, width, height and parameters of each camera in a file."""
    if file.suffix == ".bin":
        data = _Bytes(file)
        for _ in data.entries(24):
            number, kind, width, height = data.take("iiQQ")
            model, count = MODELS.get(kind, (str(kind), 0))
            yield number, model, width, height, data.take(f"{count}d")
        return
    for line, text in _lines(file):
        words = text.split()
        if not words:
            continue
        try:
            number, width, height = int(words[0]), int(words[2]), int(words[3])
            params = tuple(map(float, words[4:]))
        except (ValueError, IndexError):
            raise _Wrong(f"line {line} is no camera") from None
        yield number, words[1], width, height, params


def _images(file: Path) -> dict[int, SparseImage]:
    images: dict[int, SparseImage] = {}
    for number, name, camera, pose in _stored_images(file):
        if number in images:
            raise _Wrong(f"has two images {number}")
        if not name.strip():
            raise _Wrong(f"image {number} has no name")
        length = float(np.linalg.norm(pose[:4]))
        if not (np.isfinite(pose).all() and abs(length - 1) < 0.01):
            raise _Wrong(f"image {number}: {pose} is no unit quaternion and translation")
        w, (x, y, z) = pose[0] / length, np.array(pose[1:4]) / length
        w2c = np.eye(4)
        w2c[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        w2c[:3, 3] = pose[4:]
        images[number] = SparseImage(name, camera, w2c)
    return images


def _stored_images(file: Path) -> Iterator[tuple[int, str, int, list[float]]]:
    """Yield id, name, camera, and quaternion (w first) with translation, of each image."""
    if file.suffix == ".bin":
        data = _Bytes(file)
        for _ in data.entries(73):
            number, *pose, camera = data.take("i7di")
            name = data.text()
            (count,) = data.take("Q")
            data.skip(24 * count)
            yield number, name, camera, pose
        return
    points_may_follow = False
    for line, text in _lines(file):
        # COLMAP writes a line of points after each image, blank if there are none. Files written
        # from known poses often lack these lines.
        if not text.strip() or (points_may_follow and _are_points(text)):
            points_may_follow = False
            continue
        match = IMAGE.fullmatch(text)
        try:
            *words, name = match.groups() if match else ()
            number, pose, camera = int(words[0]), list(map(float, words[1:8])), int(words[8])
        except ValueError:
            raise _Wrong(f"line {line} is no image, nor the points of one") from None
        yield number, name, camera, pose
        points_may_follow = True


def _are_points(text: str) -> bool:
    """Tell whether a line consists of triples of x, y and point id, -1 for none."""
    numbers = text.split()
    try:
        for k in range(0, len(numbers), 3):
            x, y, point = numbers[k : k + 3]
            float(x), float(y), int(point)
    except ValueError:
        return False
    return True


def _points(file: Path) -> tuple[np.ndarray, np.ndarray]:
    if file.suffix == ".txt":
        return _text_points(file)
    data = _Bytes(file)
    # Id, position, colour, error, number of images, then these images. There may be millions of
    # points, so only the counts are read one by one.
    starts, counts = [], []
    for _ in data.entries(51):
        starts.append(data.skip(43))
        (count,) = data.take("Q")
        data.skip(8 * count)
        counts.append(count)
    begin, many = np.array(starts, np.int64), np.array(counts, np.int64)
    raw = np.frombuffer(data.data, np.uint8)
    points = raw[begin[:, None] + 8 + np.arange(24)].view("<f8")
    rows = np.repeat(np.arange(len(begin)), many)
    nth = np.arange(len(rows)) - np.repeat(np.cumsum(many) - many, many)
    images = raw[(begin[rows] + 51 + 8 * nth)[:, None] + np.arange(4)].view("<i4")
    return points, np.stack([rows, images[:, 0].astype(np.int64)], 1)


def _text_points(file: Path) -> tuple[np.ndarray, np.ndarray]:
    points, sightings = [], []
    for line, text in _lines(file):
        words = text.split()
        if not words:
            continue
        try:
            points.append(tuple(map(float, words[1:4])))
            track = list(map(int, words[8:]))
        except ValueError:
            track = [0]
        if len(words) < 8 or len(track) % 2 or not all(0 <= t < 2**32 for t in track[::2]):
            raise _Wrong(f"line {line} is no point")
        sightings += [(len(points) - 1, image) for image in track[::2]]
    return np.array(points).reshape(-1, 3), np.array(sightings, np.int64).reshape(-1, 2)


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line that is not a comment."""
    try:
        lines = read_lines(file)
    except UnicodeDecodeError:
        raise _Wrong("is not text") from None
    for number, line in enumerate(lines, 1):
        if not line.lstrip().startswith("#"):
            yield number, line
