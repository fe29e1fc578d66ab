"""LLFF scenes: photographs and one ``poses_bounds.npy`` with a row of 17 numbers for each.

A row is a 3x5 matrix by rows, then the depth range: camera-to-world axes in the columns down,
right, backward, the camera's position, and (height, width, focal length) in pixels of the whole
photograph (https://github.com/Fyusion/LLFF#using-your-own-poses-without-running-colmap). There are
no names: row i belongs to the i-th photograph by name. Cameras are assumed to be pinholes with the
principal point in the centre.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from slgaussian.datasets.photographs import (
    has_shape,
    image_folder,
    make_scene,
    photographs_in,
    stored_size,
)
from slgaussian.datasets.sparse_model import SparseModel
from slgaussian.datasets.unposed import find_folder
from slgaussian.errors import InputError
from slgaussian.formats.images import read_npy
from slgaussian.io import explain_write_errors, write_file
from slgaussian.scene import Camera, Scene

FILE = "poses_bounds.npy"
ROW_LENGTH = 17
BOUNDS = (0.1, 99.9)
"""Percentiles of the depth of a photograph's points that are written as its range."""


def read(path: str | Path, images: str | None = None) -> Scene:
    """Read a scene; views are named by the files of their photographs and opened when read.

    ``near`` and ``far`` are those of the file.

    Args:
        path: Folder with ``poses_bounds.npy``, or such a file.
        images: Subfolder of the photographs; default ``images``, or the largest of ``images_2`` and
            so on. The focal length is scaled to their size.

    Raises:
        InputError: If the file is missing or damaged, a row is not a valid camera, or the numbers
            of photographs and rows differ.
    """
    path = Path(path)
    file = path if path.is_file() else path / FILE
    folder = image_folder(file.parent, images)
    try:
        rows = read_npy(file)
    except OSError as bad:
        raise InputError(f"{file}: cannot be read ({bad.strerror or bad})") from None
    except ValueError as bad:
        raise InputError(f"{file}: is no array of numbers ({bad}); write it again") from None
    if (
        rows.ndim != 2
        or rows.shape[1] != ROW_LENGTH
        or rows.dtype.kind not in "fiu"
        or not len(rows)
    ):
        raise InputError(
            f"{file}: found {rows.dtype} {rows.shape}, expected a row of {ROW_LENGTH} numbers "
            "for each photograph"
        )
    photographs = photographs_in(folder)
    if len(photographs) != len(rows):
        raise InputError(
            f"{file}: has {len(rows)} rows, but {folder} has {len(photographs)} photographs; there "
            "must be one for each row, in the order of their names, and nothing else"
        )
    files, cameras = {}, {}
    for photograph, row in zip(photographs, rows.astype(np.float64), strict=True):
        files[photograph.name] = photograph
        try:
            cameras[photograph.name] = _camera(row, photograph)
        except InputError as bad:
            raise InputError(f"{file}: row of {photograph.name!r}: {bad}") from None
    return make_scene(file.resolve().parent.name or "scene", cameras, files, file, [file])


def _camera(row: np.ndarray, photograph: Path) -> Camera:
    """Return the camera of a row, for a photograph that may be stored at another size."""
    matrix, (near, far) = row[:15].reshape(3, 5), row[15:]
    height, width, focal = matrix[:, 4]
    if not (np.isfinite(row).all() and height >= 1 and width >= 1):
        raise InputError(f"has {width:g}x{height:g} pixels, or NaN or infinity")
    down, right, back = matrix[:, :3].T
    w, h = stored_size(photograph, (width, height)) or (round(width), round(height))
    if not has_shape((w, h), (width, height)):
        raise InputError(
            f"has {width:g}x{height:g} pixels, but the photograph is {w}x{h}, another shape; it "
            "was cropped or turned"
        )
    c2w = np.eye(4)
    c2w[:3, :4] = np.stack([right, down, -back, matrix[:, 3]], 1)
    K = np.array([[focal * w / width, 0, w / 2], [0, focal * h / height, h / 2], [0, 0, 1]])
    return Camera(K, c2w, w, h, float(near), float(far))


def write(file: Path, photographs: Mapping[str, Path], model: SparseModel) -> None:
    """Write cameras so that :func:`read` returns equal ones, with the range of their points.

    Args:
        photographs: mapping str -> path. Photographs by the names of their cameras: all in one
            folder, which has no others, as rows have no names.

    Raises:
        InputError: If that is not so, a lens is distorted, a photograph shows too few points,
            or it cannot be written.
    """
    if model.distortions:
        raise InputError(
            f"{file}: cannot hold the distortion of {next(iter(model.distortions))!r}; write "
            "COLMAP or transforms.json, or undistort the photographs"
        )
    named = {photographs[name].name: name for name in model.cameras}
    folder = find_folder({name: photographs[name] for name in model.cameras})
    present = [photograph.name for photograph in photographs_in(folder)]
    if different := sorted({*present} ^ {*named}):
        raise InputError(
            f"{file}: has a row for each photograph of a folder, without names, but of {folder} "
            f"{different[0]!r} has {'no camera' if different[0] in present else 'one elsewhere'}; "
            "write COLMAP or transforms.json, or give all photographs of one folder"
        )
    rows, views = [], list(model.cameras)
    for name in (named[file_name] for file_name in present):
        camera, mine = model.cameras[name], model.tracks.view == views.index(name)
        depth = model.points[model.tracks.track[mine]] @ camera.w2c[2, :3] + camera.w2c[2, 3]
        if len(depth) < 2:
            raise InputError(
                f"{file}: {name!r} shows {len(depth)} points, expected two or more, which give its "
                "range of depth; write COLMAP or transforms.json"
            )
        right, down, forward, place = camera.c2w[:3].T
        lens = camera.height, camera.width, camera.K[0, 0]
        matrix = np.column_stack([down, right, -forward, place, lens])
        rows.append([*matrix.ravel(), *np.percentile(depth, BOUNDS)])
    with explain_write_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    content = io.BytesIO()
    np.save(content, np.array(rows))
    write_file(file, content.getvalue())
