"""COLMAP reconstructions: undistorted images and the cameras of the sparse model.

COLMAP's poses are world-to-camera with OpenCV axes, and its pixel centres lie at +0.5, as here. The
files are ``.bin`` or ``.txt`` (https://colmap.github.io/format.html); points are not read, and the
newer files of rigs and frames repeat the poses. A model by :mod:`slgaussian.datasets.colmap_writer`
says how its cameras were found. pycolmap reads these files too, but for a truncated file some
versions (such as 4.2.1) return arbitrary numbers, hang or end the process.
"""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.datasets.lens import Maps, lens_maps
from slgaussian.datasets.photographs import (
    find_file,
    has_shape,
    image_folder,
    is_there,
    make_scene,
    name_in,
    stored_size,
)
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.io import file_sha256, read_lines
from slgaussian.scene import Camera, Estimated, Scene

MODEL_FOLDERS = ("sparse", "colmap/sparse", ".")
"""Folders of the model, or of models in subfolders 0, 1, ..., relative to the scene's folder."""

CAMERA_MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5),
    4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12),
    8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5),
    14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4),
}  # fmt: skip
"""Supported camera models, those that OpenCV has too: name and number of parameters by id."""


RECORD_FILE = "slgaussian.json"
"""File in a model's folder about found cameras: ``files``, the SHA-256 of the model's files by
name; ``estimation``, see :meth:`slgaussian.cameras.estimated.EstimatedCameras.as_json`;
``estimated``, by image, the attribute of its camera."""


class _Intrinsics(NamedTuple):
    model: str
    width: int
    height: int
    params: tuple[float, ...]


class _Pose(NamedTuple):
    camera: int
    w2c: np.ndarray  # float64 [4, 4]


def read(path: str | Path, images: str | None = None) -> Scene:
    """Read a scene; photographs are opened and undistorted when a view is read.

    If there are several models (COLMAP writes one for each group of images that it cannot connect),
    the model with most images is read, with a warning. Views are named by their path below the
    folder of photographs, as in the model, and sorted by it. Undistorted views have the focal
    lengths and principal point of the lens; pixels outside the lens's image are unknown. If
    photographs were downscaled (all of one camera equally), the cameras are scaled too.

    Args:
        path: Folder of the scene, with the model in ``sparse/0``, ``sparse`` or itself; or the
            folder of one model.
        images: Subfolder of the photographs; default ``images``, or the largest of ``images_2`` and
            so on.

    Raises:
        InputError: If there is no model, a file of it is damaged, or a camera model is not
            supported. A missing or unreadable photograph is an error only when its view is read.
    """
    path = Path(path)
    models = models_in(path)
    source = largest(models) if models else path / MODEL_FOLDERS[0] / "0"
    if len(models) > 1:
        sizes = ", ".join(f"{_count_images(place)} in {place.name}" for place in models)
        warnings.warn(
            f"{source.parent}: has several models ({sizes} images), of which {source.name} is "
            f"taken; give the folder of another one to take that",
            stacklevel=2,
        )
    path = scene_folder(path)
    folder = image_folder(path, images)
    stored_cameras, stored_poses = _read_model(source)
    if not stored_poses:
        raise InputError(f"{source}: has no posed image; reconstruct again")
    poses: dict[str, _Pose] = {}
    for stored_name, pose in stored_poses:
        name = name_in(folder, stored_name)
        if name in poses:
            raise InputError(f"{source}: two images are called {name!r}; remove one")
        poses[name] = pose
    files = {
        name: find_file(folder / name) or find_file(path / name) or folder / name
        for name in sorted(poses)
    }
    lenses = {}
    for number, stored in stored_cameras.items():
        camera_files = (file for name, file in files.items() if poses[name].camera == number)
        lenses[number] = _lens(stored, next(filter(is_there, camera_files), None))
    record = read_record(source)
    estimated, cameras, maps = record.get("estimated", {}), {}, {}
    for name in files:
        K, size, lens = lenses[poses[name].camera]
        if lens is not None:
            maps[name] = lens
        try:
            origin = Estimated.of(estimated[name]) if name in estimated else None
            c2w = np.linalg.inv(poses[name].w2c)
            cameras[name] = Camera(K, c2w, *size, estimated=origin)
        except (InputError, ValueError) as bad:
            raise InputError(f"{source}: image {name!r}: {bad}") from None
    name = path.resolve().name or "scene"
    used = [*model_files(source), *([source / RECORD_FILE] if record else [])]
    return make_scene(name, cameras, files, source, used, maps, estimation=record.get("estimation"))


def read_record(folder: Path) -> dict[str, Any]:
    """Read :data:`RECORD_FILE` of a model; empty if there is none, or it is of other files.

    Raises:
        InputError: If it is damaged.
    """
    file = folder / RECORD_FILE
    if not file.is_file():
        return {}
    with _explain_damage(file):
        record = strict_json.parse(file.read_bytes())
        if not isinstance(record, dict) or not all(
            isinstance(record.get(key), dict) for key in ("files", "estimation", "estimated")
        ):
            raise ValueError("expected an object of files, estimation and estimated")
    model = (file for file in folder.iterdir() if file.suffix in (".bin", ".txt"))
    unchanged = {file.name: file_sha256(file) for file in model} == record["files"]
    return record if unchanged else {}


def models_in(path: Path) -> list[Path]:
    """List the folders of the models of a scene by number; empty if there is no model."""
    for place in (path / place for place in MODEL_FOLDERS):
        numbered = [f for f in place.glob("*") if f.name.isdecimal() and model_files(f)]
        if numbered or model_files(place):
            return sorted(numbered, key=lambda folder: int(folder.name)) or [place]
    return []


def largest(models: Sequence[Path]) -> Path:
    """Return the model with most images, the first in a tie."""
    return models[0] if len(models) == 1 else max(models, key=_count_images)


def scene_folder(path: Path) -> Path:
    """Return the folder of the scene that contains a model or a folder of models; else ``path``.

    If two folders are possible, as above ``colmap/sparse``, the one with photographs is returned.
    """
    place = Path(os.path.abspath(path))
    model = place.parent if place.name.isdecimal() else place
    above = [f for f in model.parents[:2] if any(f / inside == model for inside in MODEL_FOLDERS)]
    with_images = (folder for folder in above if image_folder(folder).is_dir())
    return next(with_images, above[-1] if above else path)


def model_files(folder: Path) -> list[Path]:
    """List the files of cameras and images in a folder, of one format; empty if one is missing."""
    pairs = ([folder / f"cameras{kind}", folder / f"images{kind}"] for kind in (".bin", ".txt"))
    return next((files for files in pairs if all(file.is_file() for file in files)), [])


def _lens(
    stored: _Intrinsics, photograph: Path | None
) -> tuple[np.ndarray, tuple[int, int], Callable[[], Maps] | None]:
    """Return K, size and undistortion of a camera, at the size of one of its photographs."""
    model, width, height, params = stored
    focals = 1 if "SIMPLE" in model or "RADIAL" in model else 2
    (cx, cy), distortion = params[focals : focals + 2], params[focals + 2 :]
    K = np.array([[params[0], 0, cx], [0, params[focals - 1], cy], [0, 0, 1]])
    size = None if photograph is None else stored_size(photograph, (width, height))
    if size is None or not has_shape(size, (width, height)):  # else it was shrunk
        size = (width, height)
    K[:2] *= np.array([[size[0] / width], [size[1] / height]])
    fisheye = "FISHEYE" in model
    is_pinhole = not fisheye and not any(distortion)
    return K, size, None if is_pinhole else partial(lens_maps, K, size, distortion, fisheye)


def _count_images(folder: Path) -> int:
    return len(_read_images(model_files(folder)[1]))


def _read_model(folder: Path) -> tuple[dict[int, _Intrinsics], list[tuple[str, _Pose]]]:
    """Read the cameras by id and the poses with their names; the binary files if both exist."""
    files = model_files(folder)
    if not files:
        raise InputError(
            f"{folder}: has no COLMAP model; expected cameras and images there, .bin or .txt"
        )
    cameras, images = _read_cameras(files[0]), _read_images(files[1])
    for name, pose in images:
        if pose.camera not in cameras:
            raise InputError(
                f"{files[1]}: {name!r} was taken with camera {pose.camera}, which "
                f"{files[0].name} does not have; the two files are not of one model"
            )
    return cameras, images


@contextmanager
def _explain_damage(file: Path) -> Iterator[None]:
    """Raise InputError, which names the file, for errors while it is read and parsed."""
    try:
        yield
    except InputError:
        raise
    except OSError as bad:
        raise InputError(f"{file}: cannot be read ({bad.strerror})") from None
    except (ValueError, IndexError, struct.error) as bad:
        raise InputError(f"{file}: is damaged or cut short ({bad}); copy it again") from None


def _read_cameras(file: Path) -> dict[int, _Intrinsics]:
    cameras: dict[int, _Intrinsics] = {}
    counts = dict(CAMERA_MODELS.values())
    with _explain_damage(file):
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
            cameras[number] = _Intrinsics(model, width, height, params)
    return cameras


def _read_images(file: Path) -> list[tuple[str, _Pose]]:
    images = []
    with _explain_damage(file):
        for numbers, camera, name in _stored_images(file):
            if not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[:4]) - 1) > 0.01:
                raise ValueError(f"image {name!r}: {numbers} is no unit quaternion and translation")
            w2c = np.eye(4)
            w2c[:3, :3] = Rotation.from_quat(np.roll(numbers[:4], -1)).as_matrix()
            w2c[:3, 3] = numbers[4:]
            images.append((name, _Pose(camera, w2c)))
    return images


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
        model, count = CAMERA_MODELS.get(kind, (str(kind), 0))
        yield number, model, width, height, data.take(f"{count}d")


def _stored_images(file: Path) -> Iterator[tuple[list[float], int, str]]:
    """Yield quaternion (w first) with translation, camera and name of each image."""
    if file.suffix == ".txt":
        for line in _lines(file):
            # COLMAP writes a line of points, triples of numbers, after each image. Files written
            # from known poses often lack these lines.
            if not _are_points(line):
                _, *words, name = line.split(None, 9)
                yield list(map(float, words[:7])), int(words[7]), name
        return
    data = _Bytes(file)
    for _ in data.entries():
        *numbers, camera = data.take("4x7di")
        name = data.text()
        data.take(f"{24 * data.take('Q')[0]}x")
        yield numbers, camera, name


def _are_points(line: str) -> bool:
    try:
        return len(list(map(float, line.split()))) % 3 == 0
    except ValueError:
        return False


def _lines(file: Path) -> Iterator[str]:
    """Yield each line that is neither blank nor a comment."""
    return (line for line in read_lines(file) if line.strip() and line.lstrip()[0] != "#")


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
