"""Reading of a COLMAP sparse model: cameras and posed images, ``.bin`` or ``.txt``.

The formats are https://colmap.github.io/format.html. Points are not read; the newer files of rigs
and frames repeat the poses. pycolmap reads these files too, but for a truncated file some versions
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
from slgaussian.io import read_lines

MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5),
    4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12),
    8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5),
    14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4),
}  # fmt: skip
"""Supported camera models, those that OpenCV has too: name and number of parameters by id."""

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


def model_files(folder: Path) -> list[Path]:
    """List the files of cameras and images in a folder, of one format; empty if one is missing."""
    pairs = ([folder / f"cameras{kind}", folder / f"images{kind}"] for kind in (".bin", ".txt"))
    return next((files for files in pairs if all(file.is_file() for file in files)), [])


def count_images(folder: Path) -> int:
    """Count the posed images of the model in a folder; errors as of :func:`read_model`."""
    return len(_checked(model_files(folder)[1], _images))


def read_model(folder: Path) -> tuple[dict[int, SparseCamera], list[SparseImage]]:
    """Read cameras by id and images from a folder; the binary files if both formats exist.

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
    for image in images:
        if image.camera not in cameras:
            raise InputError(
                f"{files[1]}: {image.name!r} was taken with camera {image.camera}, which "
                f"{files[0].name} does not have; the two files are not of one model"
            )
    return cameras, images


def _checked(file: Path, read: Callable[[Path], T]) -> T:
    try:
        return read(file)
    except InputError:
        raise
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
        if number in cameras:
            raise ValueError(f"it has two cameras {number}")
        if model not in counts:
            raise InputError(
                f"{file}: camera {number} is of model {model}, expected one of "
                f"{', '.join(counts)}; undistort with `colmap image_undistorter`"
            )
        if len(params) != counts[model] or not np.isfinite(params).all():
            raise ValueError(f"camera {number}: {model} with parameters {params}")
        if not (0 < width < 1e6 and 0 < height < 1e6):
            raise ValueError(f"camera {number} has {width}x{height} pixels")
        cameras[number] = SparseCamera(model, width, height, params)
    return cameras


def _stored_cameras(file: Path) -> Iterator[tuple[int, str, int, int, tuple[float, ...]]]:
    """Yield id, model, width, height and parameters of each camera in a file."""
    if file.suffix == ".txt":
        for words in map(str.split, _lines(file)):
            params = tuple(map(float, words[4:]))
            yield int(words[0]), words[1], int(words[2]), int(words[3]), params
        return
    data = _Bytes(file)
    for _ in data.entries():
        number, kind, width, height = data.take("iiQQ")
        model, count = MODELS.get(kind, (str(kind), 0))
        yield number, model, width, height, data.take(f"{count}d")


def _images(file: Path) -> list[SparseImage]:
    images = []
    for pose, camera, name in _stored_images(file):
        if not np.isfinite(pose).all() or abs(np.linalg.norm(pose[:4]) - 1) > 0.01:
            raise ValueError(f"image {name!r}: {pose} is no unit quaternion and translation")
        w2c = np.eye(4)
        w2c[:3, :3] = Rotation.from_quat(np.roll(pose[:4], -1)).as_matrix()
        w2c[:3, 3] = pose[4:]
        images.append(SparseImage(name, camera, w2c))
    return images


def _stored_images(file: Path) -> Iterator[tuple[list[float], int, str]]:
    """Yield quaternion (w first) with translation, camera and name of each image."""
    if file.suffix == ".txt":
        for line in _lines(file):
            # COLMAP writes a line of points, triples of numbers, after each image. Files written
            # from known poses often lack these lines.
            if not _are_points(line):
                _, *numbers, name = line.split(None, 9)
                yield list(map(float, numbers[:7])), int(numbers[7]), name
        return
    data = _Bytes(file)
    for _ in data.entries():
        *pose, camera = data.take("4x7di")
        name = data.text()
        data.take(f"{24 * data.take('Q')[0]}x")
        yield pose, camera, name


def _are_points(line: str) -> bool:
    try:
        return len(list(map(float, line.split()))) % 3 == 0
    except ValueError:
        return False


def _lines(file: Path) -> Iterator[str]:
    """Yield each line that is neither blank nor a comment."""
    for line in read_lines(file):
        if line.strip() and not line.lstrip().startswith("#"):
            yield line
