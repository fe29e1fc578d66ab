"""nerfstudio's ``transforms.json``: photographs, intrinsics, lens distortion, poses, masks, depth.

The format is https://docs.nerf.studio/quickstart/data_conventions.html, plus keys of instant-ngp
(https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md). Poses are
camera-to-world with OpenGL axes (y up, z backward); the principal point is relative to the corner
of the image, with pixel centres at +0.5, as here.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.datasets.lens import straightened
from slgaussian.datasets.nerfstudio_frame import OPENGL, OWN, Frame
from slgaussian.datasets.photographs import absent, name_in
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.io import write_atomic
from slgaussian.scene import Camera, Scene, View

FILE = "transforms.json"


def read(path: str | Path) -> Scene:
    """Read a scene; photographs are opened and undistorted when a view is read.

    Views are named by their ``file_path``. Every number may be at the top level or in a frame,
    which has priority, also under another key: the focal length is ``fl_x``, or given as the angle
    ``camera_angle_x`` (radians) or ``x_fov`` (degrees); likewise for y, which defaults to x. ``cx``
    and ``cy`` default to the image centre; ``w`` and ``h`` to the size of the first photograph that
    exists. ``is_fisheye`` means ``camera_model`` OPENCV_FISHEYE. Undistorted views have the same K;
    pixels outside the lens's image are black, with depth 0.

    Images are converted to RGB uint8: grey is repeated, 16 bits are scaled, transparent pixels are
    composited over black and marked in ``View.opaque``. An EXIF orientation is applied only if w
    and h fit the rotated photograph (:func:`slgaussian.datasets.photographs.open_photograph`).
    ``mask_path`` is a second alpha channel. Depth (16-bit image or .npy, z-depth) is scaled by
    ``depth_unit_scale_factor`` and, like the poses, by ``applied_scale``, resampled at the image's
    pixel centres, and 0 where it is not positive. A view without a depth file has no depth; a depth
    file of an unsupported format is ignored with a warning.

    Args:
        path: ``transforms.json`` or the folder that holds it; other paths are relative to that
            folder.

    Raises:
        InputError: If the file is missing or damaged, a frame is invalid, or it has an unsupported
            key that may change the image (``CHANGES_PIXELS`` of
            :mod:`slgaussian.datasets.nerfstudio_frame`). A missing or unreadable photograph is an
            error only when its view is read.
    """
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    meta = _load(file)
    frames: dict[str, Frame] = {}
    shared = {key: value for key, value in meta.items() if key not in (OWN, "frames")}
    estimation = meta.get(OWN, {})
    if not isinstance(estimation, dict):
        raise InputError(
            f"{file}: {OWN} is {estimation!r}, expected an object; write the file again"
        )
    for number, entry in enumerate(meta["frames"]):
        name = entry.get("file_path") if isinstance(entry, dict) else None
        if not isinstance(name, str) or not name:
            raise InputError(f"{file}: frame {number} has no file_path; add the photograph's path")
        name = name_in(file.parent, name)
        if name in frames:
            raise InputError(f"{file}: two frames have the file_path {name!r}; remove one")
        frames[name] = Frame.of(file, name, entry, shared)
    size = next((s for s in (frame.stored_size() for frame in frames.values()) if s), None)
    cameras = {name: frame.camera(size) for name, frame in frames.items()}

    name = file.resolve().parent.name or "scene"
    read_view, sources = partial(_read_view, frames, cameras), partial(_sources, frames)
    return Scene(name, cameras, read_view, found=estimation, sources=sources)


def _read_view(frames: Mapping[str, Frame], cameras: Mapping[str, Camera], name: str) -> View:
    """Open and undistort a frame."""
    if name not in frames:
        file = next(iter(frames.values())).file
        raise InputError(f"{file}: no frame has the file_path {name!r}")
    frame, camera = frames[name], cameras[name]
    if frame.image_path is None:
        photographs = {n: f.image_path or f.file.parent / n for n, f in frames.items()}
        raise absent(photographs[name], frame.file.name, photographs)
    image, opaque = frame.image(frame.image_path, camera)
    view = View(name, camera, image, frame.depth(camera), opaque=opaque)
    maps = frame.undistortion(camera)
    return view if maps is None else straightened(view, maps)


def _sources(frames: Mapping[str, Frame], name: str) -> list[Path]:
    """List the camera file and the photograph, mask and depth file of a frame."""
    frame = frames[name]
    named = [frame.place(value) for key, value in frame.values.items() if key.endswith("_path")]
    return [frame.file, *([] if frame.image_path is None else [frame.image_path]), *named]


def write(file: Path, photographs: Mapping[str, Path], estimated: EstimatedCameras) -> None:
    """Write estimated cameras and their uncertainty so that :func:`read` returns equal cameras.

    Args:
        file: An existing file is replaced.
        photographs: mapping str -> path. Photographs by the names of their cameras.

    Raises:
        InputError: If it cannot be written.
    """
    folder = os.path.abspath(file.parent)
    paths = {
        name: Path(os.path.relpath(os.path.abspath(photograph), folder)).as_posix()
        for name, photograph in photographs.items()
    }
    frames = []
    for name, camera in estimated.cameras.items():
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        extra: dict[str, Any] = {"near": camera.near, "far": camera.far}
        if camera.estimated is not None:
            extra["estimated"] = asdict(camera.estimated)
        frame = {"file_path": paths[name], "transform_matrix": (camera.c2w * OPENGL).tolist()}
        frame |= {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
        frame |= {"w": camera.width, "h": camera.height, "k1": estimated.k1[name], OWN: extra}
        frames.append(frame)
    record = estimated.as_json()
    for key in ("focals", "k1", "left_out"):
        record[key] = {paths[name]: value for name, value in record[key].items()}
    for pair in record["pairs"]:
        pair["views"] = [paths[name] for name in pair["views"]]
    content = {"camera_model": "OPENCV", "frames": frames, OWN: record}
    try:
        write_atomic(file, (json.dumps(content, indent=1) + "\n").encode())
    except OSError as bad:
        raise InputError(f"{file}: cannot be written ({bad.strerror}); choose another") from bad


def read_cameras(path: str | Path) -> dict[str, Camera]:
    """Read the cameras of a file by name; photographs are needed only if it lacks their size.

    Args:
        path: ``transforms.json`` or the folder that holds it; or the JSON of one frame by itself,
            as ``{"fl_x": 500, "w": 640, "h": 480, "transform_matrix": [[...], ...]}``, whose camera
            is named by ``file_path``, or else by the file. Keys and axes as in :func:`read`. Or a
            camera path exported by nerfstudio's viewer, with frames named ``frame 0``, ``frame 1``,
            ...

    Raises:
        InputError: If the file is missing or damaged, or a camera of it is invalid.
    """
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    content = _parsed(file)
    if isinstance(content, dict) and "transform_matrix" in content and "frames" not in content:
        name = str(content.get("file_path") or file.name)
        return {name: Frame.of(file, name, content).camera(None)}
    if isinstance(content, dict) and "camera_path" in content:
        return _camera_path(file, content)
    return dict(read(path).cameras)


def _camera_path(file: Path, content: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the cameras of a camera path; ``fov`` is the vertical field of view in degrees.

    The format is that of ``get_path_from_json`` in nerfstudio 1.1 (``cameras/camera_paths.py``).
    """
    if (kind := content.get("camera_type", "perspective")) != "perspective":
        raise InputError(f"{file}: has cameras of type {kind!r}; expected 'perspective'")
    if content.get("crop"):
        raise InputError(f"{file}: crops the scene, which is not done here; leave out 'crop'")
    try:
        width, height = int(content["render_width"]), int(content["render_height"])
        cameras = {}
        for number, frame in enumerate(content["camera_path"]):
            c2w = np.array(frame["camera_to_world"], np.float64).reshape(4, 4)
            focal = height / 2 / np.tan(np.radians(float(frame["fov"])) / 2)
            K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
            cameras[f"frame {number}"] = Camera(K, c2w * OPENGL, width, height)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{file}: is no camera path of nerfstudio's ({type(error).__name__}: {error}); "
            "expected render_width, render_height and camera_path with camera_to_world and fov"
        ) from None
    if not cameras:
        raise InputError(f"{file}: has no camera")
    return cameras


def _parsed(file: Path) -> Any:
    try:
        return strict_json.parse(file.read_bytes())
    except OSError as bad:
        raise InputError(
            f"{file}: cannot be read ({bad.strerror}); give a {FILE} or the folder that holds one"
        ) from None
    except ValueError as bad:
        raise InputError(f"{file}: is not valid JSON ({bad}); write it again") from None


def _load(file: Path) -> dict[str, Any]:
    meta = _parsed(file)
    if not isinstance(meta, dict) or not isinstance(meta.get("frames"), list) or not meta["frames"]:
        raise InputError(f"{file}: lists no frames; expected nerfstudio's form with a frames list")
    return meta
