"""Reading of a COLMAP sparse model: cameras, posed images and points, ``.bin`` or ``.txt``.

The formats are https://colmap.github.io/format.html; the newer files of rigs and frames repeat the
poses and are not needed. pycolmap reads these files too, but for a truncated file some versions
(such as 4.2.1) return arbitrary numbers, hang or end the process.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

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
    """Count the posed images of the model in a folder; errors as of :func:`read_model`."""
    return len(_checked(model_files(folder)[1], _images))


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
    except (ValueError, IndexError, struct.error) as bad:
        raise InputError(f"{file}: is damaged or cut short ({bad}); copy it again") from None


class _Bytes:
    """Sequential reader of a binary file; struct.error or ValueError past its end."""

    def __init__(self, file: Path):
        self.data = file.read_bytes()
        self.at = 0

    def take(self, layout: str) -> tuple:
        """Return the next values for a :mod:`struct` format."""
        values = struct.unpack_from(f"<{layout}", self.data, self.at)
        self.at += struct.calcsize(f"<{layout}")
        return values

    def text(self) -> str:
        """Return the text up to the next zero byte."""
        start, end = self.at, self.data.index(b"\0", self.at)
        self.at = end + 1
        return self.data[start:end].decode("utf-8", "replace")

    def entries(self) -> Iterator[int]:
        """Yield the index of each entry, whose count is the first number of the file."""
        yield from range(self.take("Q")[0])
        if self.at != len(self.data):
            raise ValueError(f"its last entry ends at byte {self.at} of {len(self.data)}")


def _cameras(file: Path) -> dict[int, SparseCamera]:
    cameras: dict[int, SparseCamera] = {}
    counts = dict(MODELS.values())
    for number, model, width, height, params in _stored_cameras(file):
        if len(params) != counts.get(model):
            raise ValueError(f"camera {number} is of model {model} with {len(params)} parameters")
        if not (0 < width < 1e6 and 0 < height < 1e6 and np.isfinite(params).all()):
            raise ValueError(f"camera {number} is {width}x{height} pixels with {params}")
        cameras[number] = SparseCamera(model, width, height, params)
    return cameras


def _stored_cameras(file: Path) -> Iterator[tuple[int, str, int, int, tuple[float, ...]]]:
    """Yield id, model, width, height and parameters of each camera in a file."""
    if file.suffix == ".txt":
        for words in map(str.split, _lines(file)):
            yield (
                int(words[0]),
                words[1],
                int(words[2]),
                int(words[3]),
                tuple(map(float, words[4:])),
            )
        return
    data = _Bytes(file)
    for _ in data.entries():
        number, kind, width, height = data.take("iiQQ")
        model, count = MODELS.get(kind, (str(kind), 0))
        yield number, model, width, height, data.take(f"{count}d")


def _images(file: Path) -> dict[int, SparseImage]:
    images: dict[int, SparseImage] = {}
    for number, pose, camera, name in _stored_images(file):
        if not np.isfinite(pose).all() or abs(np.linalg.norm(pose[:4]) - 1) > 0.01:
            raise ValueError(f"image {number}: {pose} is no unit quaternion and translation")
        w2c = np.eye(4)
        w2c[:3, :3] = Rotation.from_quat(np.roll(pose[:4], -1)).as_matrix()
        w2c[:3, 3] = pose[4:]
        images[number] = SparseImage(name, camera, w2c)
    return images


def _stored_images(file: Path) -> Iterator[tuple[int, list[float], int, str]]:
    """Yield id, quaternion (w first) with translation, camera and name of each image."""
    if file.suffix == ".txt":
        for line in _lines(file):
            # COLMAP writes a line of points, triples of numbers, after each image. Files written
            # from known poses often lack these lines.
            if not _are_points(line):
                *numbers, name = line.split(None, 9)
                yield int(numbers[0]), list(map(float, numbers[1:8])), int(numbers[8]), name
        return
    data = _Bytes(file)
    for _ in data.entries():
        number, *pose, camera = data.take("i7di")
        name = data.text()
        data.take(f"{24 * data.take('Q')[0]}x")
        yield number, pose, camera, name


def _are_points(line: str) -> bool:
    try:
        return len(list(map(float, line.split()))) % 3 == 0
    except ValueError:
        return False


def _points(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read positions and observations, as in :class:`SparseModel`."""
    points: list[tuple[float, ...]] = []
    tracks: list[tuple[int, ...]] = []
    if file.suffix == ".txt":
        for words in map(str.split, _lines(file)):
            points.append((float(words[1]), float(words[2]), float(words[3])))
            tracks.append(tuple(map(int, words[8::2])))
    else:
        data = _Bytes(file)
        for _ in data.entries():
            *position, count = data.take("8x3d11xQ")
            points.append(tuple(position))
            tracks.append(data.take(f"{2 * count}i")[::2])
    rows = np.repeat(np.arange(len(points)), list(map(len, tracks)))
    images = np.array([image for track in tracks for image in track], np.int64)
    return np.array(points, np.float64).reshape(-1, 3), np.stack([rows, images], 1)


def _lines(file: Path) -> Iterator[str]:
    """Yield each line that is neither blank nor a comment."""
    for line in read_lines(file):
        if line.strip() and not line.lstrip().startswith("#"):
            yield line
