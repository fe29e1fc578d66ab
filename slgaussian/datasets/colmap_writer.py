"""Sparse models in COLMAP's files ``cameras``, ``images`` and ``points3D``, binary or text.

The format is https://colmap.github.io/format.html: poses are world-to-camera with OpenCV axes,
pixel centres lie at +0.5, and numbers in binary files are little-endian.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.datasets.colmap import RECORD_FILE, read_record
from slgaussian.datasets.sparse_model import SparseModel
from slgaussian.errors import InputError
from slgaussian.io import atomic_folder, explain_write_errors, file_sha256
from slgaussian.scene import Camera

PINHOLE, SIMPLE_RADIAL = ("PINHOLE", 1), ("SIMPLE_RADIAL", 2)
"""Names of camera models in text, and their ids in binary files."""


class Lens(NamedTuple):
    """A camera of COLMAP's, which images may share."""

    model: tuple[str, int]
    width: int
    height: int
    params: tuple[float, ...]


def check_folder(folder: Path) -> None:
    """Check that a model may be written to a folder.

    Raises:
        InputError: If it exists, and neither is empty nor has a model that :func:`write` left and
            nobody has changed since.
    """
    if not folder.exists():
        return
    files = read_record(folder).get("files", {})
    if not folder.is_dir() or {file.name for file in folder.iterdir()} - {RECORD_FILE, *files}:
        raise InputError(
            f"{folder}: exists and is no COLMAP model as `slgaussian cameras` wrote it; choose "
            "another folder, or remove it"
        )


def write(folder: Path, model: SparseModel, estimated: EstimatedCameras, text: bool) -> None:
    """Write a model so that :func:`slgaussian.datasets.colmap.read` returns equal cameras.

    A file :data:`slgaussian.datasets.colmap.RECORD_FILE` beside COLMAP's says how they were found.
    Images are numbered in the order of the cameras, and those of one lens share a camera.

    Args:
        folder: As :func:`check_folder` permits. It is replaced wholly or not at all.
        text: Whether to write text files.

    Raises:
        InputError: If it cannot be written, or a name cannot be in a text file.
    """
    if text and (spaced := next((name for name in model.cameras if " " in name), None)):
        raise InputError(
            f"{spaced!r}: has a space, which ends a name in COLMAP's text files; write the binary "
            "ones, or rename it"
        )
    encode = _text_files if text else _binary_files
    with explain_write_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(folder) as draft:
        for name, content in encode(model).items():
            (draft / name).write_bytes(content)
        record = {
            "files": {file.name: file_sha256(file) for file in sorted(draft.iterdir())},
            "estimation": estimated.as_json(),
            "estimated": {
                name: asdict(camera.estimated)
                for name, camera in model.cameras.items()
                if camera.estimated is not None
            },
        }
        (draft / RECORD_FILE).write_text(json.dumps(record, indent=1) + "\n", "utf-8")


def _lens(camera: Camera, k1: float) -> Lens:
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    size = camera.width, camera.height
    if k1:
        return Lens(SIMPLE_RADIAL, *size, (fx, cx, cy, k1))
    return Lens(PINHOLE, *size, (fx, fy, cx, cy))


def _number_lenses(model: SparseModel) -> tuple[dict[Lens, int], list[int]]:
    """Return the number of each lens, and that of each image's."""
    lenses = [
        _lens(camera, model.distortions.get(name, 0)) for name, camera in model.cameras.items()
    ]
    numbers = {lens: k for k, lens in enumerate(dict.fromkeys(lenses), 1)}
    return numbers, [numbers[lens] for lens in lenses]


def _images(model: SparseModel) -> Iterator[tuple[list[Any], str, list[Any]]]:
    """Yield number, pose and lens of each image; its name; and x, y and point of what it shows."""
    _, lenses = _number_lenses(model)
    for view, (name, camera) in enumerate(model.cameras.items()):
        quaternion = Rotation.from_matrix(camera.w2c[:3, :3]).as_quat(canonical=True)
        pose = [*np.roll(quaternion, 1).tolist(), *camera.w2c[:3, 3].tolist()]
        mine = model.tracks.view == view
        seen = zip(model.tracks.xy[mine].tolist(), model.tracks.track[mine].tolist(), strict=True)
        shown = [value for (x, y), point in seen for value in (x, y, point + 1)]
        yield [view + 1, *pose, lenses[view]], name, shown


def _points(model: SparseModel) -> Iterator[tuple[list[Any], list[int]]]:
    """Yield number, position, colour and error of each point; and image and index in its track."""
    view, track = model.tracks.view, model.tracks.track
    index = np.zeros(len(view), int)
    for number in range(len(model.cameras)):
        index[view == number] = np.arange((view == number).sum())
    tracks = np.split(np.stack([view + 1, index], 1), np.flatnonzero(np.diff(track)) + 1)
    values = model.points.tolist(), model.colours.tolist(), model.errors.tolist(), tracks
    # Without points, the tracks are one empty part.
    for number, (position, colour, error, seen) in enumerate(zip(*values, strict=False), 1):
        yield [number, *position, *colour, error], seen.ravel().tolist()


def _binary_files(model: SparseModel) -> dict[str, bytes]:
    numbers, _ = _number_lenses(model)
    cameras = [
        struct.pack(f"<iiQQ{len(params)}d", number, kind[1], width, height, *params)
        for (kind, width, height, params), number in numbers.items()
    ]
    images = [
        struct.pack("<i7di", *head) + name.encode() + b"\0"
        + struct.pack("<Q" + "ddq" * (len(shown) // 3), len(shown) // 3, *shown)
        for head, name, shown in _images(model)
    ]  # fmt: skip
    points = [
        struct.pack(f"<Q3d3BdQ{len(track)}i", *head, len(track) // 2, *track)
        for head, track in _points(model)
    ]
    files = {"cameras.bin": cameras, "images.bin": images, "points3D.bin": points}
    return {name: struct.pack("<Q", len(rows)) + b"".join(rows) for name, rows in files.items()}


def _text_files(model: SparseModel) -> dict[str, bytes]:
    numbers, _ = _number_lenses(model)
    files: dict[str, list[list[Any]]] = {"cameras.txt": [], "images.txt": [], "points3D.txt": []}
    for (kind, width, height, params), number in numbers.items():
        files["cameras.txt"].append([number, kind[0], width, height, *params])
    for head, name, shown in _images(model):
        files["images.txt"] += [*head, name], shown
    for head, track in _points(model):
        files["points3D.txt"].append([*head, *track])
    return {
        name: "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
        for name, rows in files.items()
    }
