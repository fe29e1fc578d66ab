"""nerfstudio's ``transforms.json``: photographs, intrinsics, lens distortion, poses, masks, depth.

The format is https://docs.nerf.studio/quickstart/data_conventions.html, plus keys of instant-ngp
(https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md). Poses are
camera-to-world with OpenGL axes (y up, z backward); the principal point is relative to the corner
of the image, with pixel centres at +0.5, as here.
"""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.checks import check_cameras
from slgaussian.datasets.lens import Maps, lens_maps
from slgaussian.datasets.photographs import (
    Mask,
    find_file,
    find_masks,
    is_there,
    name_in,
    open_view,
    read_view,
    stored_size,
)
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.formats.depth_maps import MILLIMETRE, known_depth, read_map
from slgaussian.formats.resampling import Window
from slgaussian.io import write_atomic
from slgaussian.scene import Camera, Estimated, Scene, View

FILE = "transforms.json"
PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
FISHEYE = "OPENCV_FISHEYE"
OPENGL_SIGNS = np.array([1.0, -1.0, -1.0, 1.0])
"""Factors of the columns of a pose between OpenCV and OpenGL axes."""

EXTENSION_KEY = "slgaussian"
"""Key of this package's additions: at the top level the record of the estimation
(:meth:`slgaussian.cameras.estimated.EstimatedCameras.as_json`), and in each frame the other fields
of a camera (``estimated``, ``near``, ``far``). Such frames refer to upright photographs."""

SUPPORTED_KEYS = {
    "w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov",
    "camera_model", "is_fisheye", "k1", "k2", "k3", "k4", "p1", "p2", "mask_path",
    "depth_unit_scale_factor", "applied_scale",
    "aabb_scale", "scale", "auto_scale_poses_override", "integer_depth_scale",
}  # fmt: skip
"""Supported keys among those that match :data:`PIXEL_KEYS`. The last line does not change the
image: it places the scene in instant-ngp's cube, or is of depth that is not read."""

PIXEL_KEYS = re.compile(
    r"lens|fish|distort|mask|rolling|readout|shutter(?!_?speed)|scale|crop|aspect|flip|skew|shear"
    r"|ortho|rectangular|latlong|pano(?!ptic)|spheri|omnidir|theta|projection|camera_?(model|type)"
    r"|focal|fov|field_of_view|camera_?angle|intrinsic|principal|shift_?[xy]|matrix_(start|end)"
    r"|^f(l?_?[xy])?$|^c_?[xy]$|^[kpsb]_?\d+$|^xi$",
    re.IGNORECASE,
)
"""Parts of key names that indicate a lens, a distortion, a mask, a shutter or a scale."""

FOCAL_KEYS = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov")
CENTRE_KEYS, MODEL_KEYS = ("cx", "cy"), ("camera_model", "is_fisheye")
DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")
"""Keys of the parts of a lens. Each part is taken whole, from the frame or from the file."""

NEUTRAL_VALUES = ("", "none", "pinhole", "perspective", "global")
"""Values of such keys, besides 0, false and null, without effect."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame; its values have priority over those of the file, and null values are dropped."""

    file: Path
    name: str
    values: ChainMap[str, Any]

    @staticmethod
    def of(file: Path, name: str, *levels: Mapping[str, Any]) -> Frame:
        """Make a frame from its values, with those of the file as defaults."""
        stated = ({k: v for k, v in level.items() if v is not None} for level in levels)
        return Frame(file, name, ChainMap(*stated))

    def error(self, problem: str) -> InputError:
        """Return an error that names file and frame."""
        return InputError(f"{self.file}: frame {self.name!r}: {problem}")

    def number(self, key: str, default: Any = None, values: Mapping[str, Any] | None = None) -> Any:
        """Return a finite number as float, or the default if the key is missing."""
        value = (self.values if values is None else values).get(key)
        if value is None:
            return default
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise self.error(f"{key} is {value!r}, expected a finite number")
        return float(value)

    @cached_property
    def image_path(self) -> Path | None:
        """Path of the stored photograph; None if it is missing."""
        return find_file(self.file.parent / self.name)

    def camera(self, size: tuple[int, int] | None) -> Camera:
        """Return the camera of the undistorted view; ``size`` is used if w and h are missing."""
        self._check_keys()
        w, h = self.number("w"), self.number("h")
        if w is None or h is None:
            if size is None:
                raise self.error("has neither w and h nor a photograph to take them from; add them")
            w, h = size
        if w != int(w) or h != int(h):
            raise self.error(f"w and h are {w:g} and {h:g}, expected whole numbers of pixels")
        for keys in (FOCAL_KEYS, CENTRE_KEYS):
            level = next((level for level in self.values.maps if level.keys() & keys), {})
            width, height = self.number("w", w, level), self.number("h", h, level)
            pixels = sorted(level.keys() & keys & {"fl_x", "fl_y", "cx", "cy"})
            if pixels and (width, height) != (w, h):
                raise self.error(
                    f"has {w:g}x{h:g} pixels, but {', '.join(pixels)} of the file are for "
                    f"{width:g}x{height:g}; state them in the frame"
                )
        fx, fy = self._part(FOCAL_KEYS, lambda level: self._focals(level, w, h))
        if fx is None:
            raise self.error("has neither fl_x nor camera_angle_x; add the focal length in pixels")
        defaults = {"cx": w / 2, "cy": h / 2}
        cx, cy = self._part(
            CENTRE_KEYS,
            lambda level: [self.number(key, defaults[key], level) for key in CENTRE_KEYS],
        )
        try:
            c2w = np.array(self.values["transform_matrix"], np.float64).reshape(4, 4) * OPENGL_SIGNS
        except (KeyError, TypeError, ValueError):
            raise self.error("has no transform_matrix of 4x4 numbers, camera-to-world") from None
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        try:
            camera = Camera(K, c2w, int(w), int(h))
            if (extra := self.values.get(EXTENSION_KEY)) is None:
                return camera
            if not isinstance(extra, dict):
                raise InputError(f"{EXTENSION_KEY} is {extra!r:.60}, expected an object")
            estimate = extra.get("estimated")
            estimated = None if estimate is None else Estimated.of(estimate)
            near, far = (self.number(name, values=extra) for name in ("near", "far"))
            return replace(camera, near=near, far=far, estimated=estimated)
        except InputError as bad:
            raise self.error(str(bad)) from None
        except ValueError as bad:
            raise self.error(f"estimated {bad}") from None

    def _check_keys(self) -> None:
        """Raise InputError for a key that may change the image and is not supported."""
        fisheye = self.values.get("is_fisheye", False)
        model = self.values.get("camera_model", FISHEYE if fisheye is True else PERSPECTIVE[0])
        if model not in (*PERSPECTIVE, FISHEYE):
            raise self.error(
                f"camera_model {model!r} cannot be read, only {', '.join(PERSPECTIVE)} and "
                f"{FISHEYE}; undistort the photographs to PINHOLE first"
            )
        if fisheye is not (model == FISHEYE) and "is_fisheye" in self.values:
            raise self.error(
                f"is_fisheye is {fisheye!r}, expected true or false as of camera_model {model}; "
                "remove the wrong one"
            )
        for key, value in self.values.items():
            if key in SUPPORTED_KEYS or not PIXEL_KEYS.search(key):
                continue
            is_colour = "mask" in key  # a mask colour of 0 is a value too
            numbers = value if isinstance(value, list) and not is_colour else [value]
            changes_nothing = str(value).lower() in NEUTRAL_VALUES or not any(numbers)
            if not changes_nothing and not (value == 1 and re.search("scale|aspect", key)):
                raise self.error(
                    f"{key} is {value!r:.60}, which may change where points are seen and is not "
                    "read; undistort the photographs to a PINHOLE camera, or remove the key if it "
                    "does not matter"
                )

    def _part(
        self, keys: Sequence[str], read: Callable[[Mapping[str, Any]], Sequence[Any]]
    ) -> Sequence[Any]:
        """Read a part of the lens from the frame if it states any of the keys, else from the file.

        If both do and differ, this emits a warning: nerfstudio itself takes it from the file.
        """
        levels = [level for level in self.values.maps if level.keys() & keys]
        parts = [read(level) for level in levels] or [read({})]
        if len(parts) > 1 and not np.allclose(parts[0], parts[1], rtol=0.01, atol=1e-4):
            frame, file = (", ".join(key for key in keys if key in level) for level in levels)
            warnings.warn(
                f"{self.file}: {frame} of a frame contradict {file} of the file; the frame's alone "
                "are used, where nerfstudio uses the file's; remove the wrong ones",
                stacklevel=2,
            )
        return parts[0]

    def _focals(self, level: Mapping[str, Any], w: float, h: float) -> tuple[Any, Any]:
        """Return the focal lengths in pixels of a level; a missing one equals the other."""
        x, y = self._focal(level, "x", w), self._focal(level, "y", h)
        return (y if x is None else x), (x if y is None else y)

    def _focal(self, level: Mapping[str, Any], axis: str, size: float) -> float | None:
        """Return the focal length in pixels along an axis, from the first key that states it."""
        focal = self.number(f"fl_{axis}", values=level)
        for key, unit in ((f"camera_angle_{axis}", 1), (f"{axis}_fov", math.pi / 180)):
            if (angle := self.number(key, values=level)) is None:
                continue
            if focal is not None:
                used = 2 * math.atan2(size / 2, focal) / unit
                if not math.isclose(angle, used, rel_tol=0.01):
                    warnings.warn(
                        f"{self.file}: {key} is {angle:g}, but {used:g} by the focal length "
                        f"{axis} of {focal:g} pixels, which is used; remove the wrong one",
                        stacklevel=2,
                    )
                continue
            if not 0 < angle * unit < math.pi:
                expected = "radians below pi" if unit == 1 else "degrees below 180"
                raise self.error(f"{key} is {angle:g}, expected {expected} and above 0")
            focal = size / 2 / math.tan(angle * unit / 2)
        return focal

    def lens(self, camera: Camera) -> Callable[[], Maps] | None:
        """Return a function that computes undistortion maps; None for a pinhole."""
        k1, k2, k3, k4, p1, p2 = self._part(
            DISTORTION_KEYS, lambda level: [self.number(key, 0.0, level) for key in DISTORTION_KEYS]
        )
        (is_fisheye,) = self._part(
            MODEL_KEYS,
            lambda level: [bool(level.get("is_fisheye")) or level.get("camera_model") == FISHEYE],
        )
        size = (camera.width, camera.height)
        if is_fisheye:
            return partial(lens_maps, camera.K, size, [k1, k2, k3, k4], fisheye=True)
        if k4:
            raise self.error(f"k4 is {k4:g}, expected a camera_model {FISHEYE} with it")
        lens = [k1, k2, p1, p2, k3]
        return partial(lens_maps, camera.K, size, lens) if any(lens) else None

    def place(self, name: Any) -> Path:
        """Resolve a path relative to the folder of the camera file."""
        return self.file.parent / name_in(self.file.parent, str(name))

    def depth(self, camera: Camera) -> np.ndarray | None:
        """Read depth float32 [H, W] in scene units, 0 where unknown; None without a depth file."""
        name = self.values.get("depth_file_path")
        if name is None or not is_there(path := self.place(name)):
            return None
        try:
            depth = read_map(path, unit=1.0, stated="depth_unit_scale_factor" not in self.values)
        except InputError as bad:
            warnings.warn(f"{bad}; the view is read without depth", stacklevel=2)
            return None
        scale = self.number("depth_unit_scale_factor", MILLIMETRE)
        scale *= self.number("applied_scale", 1.0)
        if scale <= 0:
            raise self.error("depth_unit_scale_factor and applied_scale must be positive")
        depth = known_depth(depth.astype(np.float64) * scale).astype(np.float32)
        photograph = Window.whole(camera.width, camera.height)
        photograph.check_shape(path, *depth.shape[::-1])
        return photograph.depth(depth, camera.height, camera.width)

    def view(self, camera: Camera, mask: Mask | None) -> View:
        """Open the photograph with its mask and depth."""
        return open_view(
            self.name,
            camera,
            self.image_path or self.file.parent / self.name,
            self.file.name,
            upright=EXTENSION_KEY in self.values,
            lens=self.lens(camera),
            mask=mask,
            depth=self.depth(camera),
        )


def read(path: str | Path) -> Scene:
    """Read a scene; photographs are opened and undistorted when a view is read.

    Views are named by their ``file_path``. Every number may be at the top level or in a frame,
    which has priority. Focal lengths, principal point, distortion and camera model are each taken
    whole from one of the two, with a warning if both state them and differ; and pixels of the file
    are refused for a frame of another size. The focal length is ``fl_x``, ``camera_angle_x``
    (radians) or ``x_fov`` (degrees), the first of them, with a warning if another contradicts it;
    likewise for y; a missing one equals the other. ``cx`` and ``cy`` default to the image centre;
    ``w`` and ``h`` to the size of the first photograph that exists. ``is_fisheye`` means
    ``camera_model`` OPENCV_FISHEYE. Undistorted views have the same K; pixels outside the lens's
    image are unknown, with depth 0.

    ``mask_path`` is a second alpha channel; without it, a mask is looked for beside the photograph
    (:func:`slgaussian.datasets.photographs.find_masks`).
    Depth along z (:func:`slgaussian.formats.depth_maps.read_map`) is scaled by
    ``depth_unit_scale_factor`` and, like the poses, by ``applied_scale``, and resampled at the
    image's pixel centres. A view whose depth file is missing has no depth;
    of one that cannot be read, a warning says so.

    Args:
        path: ``transforms.json`` or the folder that holds it; other paths are relative to that
            folder.

    Raises:
        InputError: If the file is missing or damaged, a frame is invalid, or it has an unsupported
            key that may change the image (:data:`PIXEL_KEYS`). A missing or unreadable
            photograph is an error only when its view is read.
    """
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    meta = _parse_file(file)
    if not isinstance(meta, dict) or not isinstance(meta.get("frames"), list) or not meta["frames"]:
        raise InputError(f"{file}: lists no frames; expected nerfstudio's form with a frames list")
    frames: dict[str, Frame] = {}
    shared = {key: value for key, value in meta.items() if key not in (EXTENSION_KEY, "frames")}
    if not isinstance(estimation := meta.get(EXTENSION_KEY, {}), dict):
        raise InputError(f"{file}: {EXTENSION_KEY} is {estimation!r:.60}, expected an object")
    for number, entry in enumerate(meta["frames"]):
        name = entry.get("file_path") if isinstance(entry, dict) else None
        if not isinstance(name, str) or not name:
            raise InputError(f"{file}: frame {number} has no file_path; add the photograph's path")
        name = name_in(file.parent, name)
        if name in frames:
            raise InputError(f"{file}: two frames have the file_path {name!r}; remove one")
        frames[name] = Frame.of(file, name, entry, shared)
    sizes = (stored_size(f.image_path) for f in frames.values() if f.image_path is not None)
    size = next((size for size in sizes if size), None)
    cameras = {name: frame.camera(size) for name, frame in frames.items()}
    name = file.resolve().parent.name or "scene"
    masks = {
        frame.name: Mask(frame.place(mask))
        for frame in frames.values()
        if (mask := frame.values.get("mask_path")) is not None
    }
    unmasked = (frame for frame in frames.values() if frame.name not in masks)
    masks |= find_masks(
        {frame.name: frame.image_path or frame.place(frame.name) for frame in unmasked}
    )
    views = {n: partial(frame.view, cameras[n], masks.get(n)) for n, frame in frames.items()}
    open_named, sources = partial(read_view, views, file), partial(_sources, frames, masks)
    return Scene(name, cameras, open_named, estimation=estimation, sources=sources)


def _sources(frames: Mapping[str, Frame], masks: Mapping[str, Mask], name: str) -> list[Path]:
    """List the camera file and the photograph, mask and depth file of a frame."""
    frame = frames[name]
    named = [frame.place(value) for key, value in frame.values.items() if key.endswith("_path")]
    named += [masks[name].file] if name in masks else []
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
        frame = {"file_path": paths[name], "transform_matrix": (camera.c2w * OPENGL_SIGNS).tolist()}
        frame |= {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
        if name in estimated.distortions:
            frame["k1"] = estimated.distortions[name]
        frame |= {"w": camera.width, "h": camera.height, EXTENSION_KEY: extra}
        frames.append(frame)
    record = estimated.as_json()
    for key in {"focals", "left_out", "distortions"} & {*record}:
        record[key] = {paths[name]: value for name, value in record[key].items()}
    for pair in record["pairs"]:
        pair["views"] = [paths[name] for name in pair["views"]]
    content = {"camera_model": "OPENCV", "frames": frames, EXTENSION_KEY: record}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
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
    content = _parse_file(file)
    if isinstance(content, dict) and "transform_matrix" in content and "frames" not in content:
        name = str(content.get("file_path") or file.name)
        cameras = {name: Frame.of(file, name, content).camera(None)}
        check_cameras(cameras, lambda _: file)
        return cameras
    if isinstance(content, dict) and "camera_path" in content:
        return _camera_path(file, content)
    return dict(read(path).cameras)


def _camera_path(file: Path, content: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the cameras of a camera path; ``fov`` is the vertical field of view in degrees.

    The format is that of ``get_path_from_json`` in nerfstudio 1.1 (``cameras/camera_paths.py``).
    """
    if content.get("camera_type", "perspective") != "perspective" or content.get("crop"):
        raise InputError(f"{file}: expected perspective cameras (camera_type) without crop")
    try:
        width, height = int(content["render_width"]), int(content["render_height"])
        cameras = {}
        for number, frame in enumerate(content["camera_path"]):
            c2w = np.array(frame["camera_to_world"], np.float64).reshape(4, 4)
            focal = height / 2 / np.tan(np.radians(float(frame["fov"])) / 2)
            K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
            cameras[f"frame {number}"] = Camera(K, c2w * OPENGL_SIGNS, width, height)
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


def _parse_file(file: Path) -> Any:
    try:
        return strict_json.parse(file.read_bytes())
    except OSError as bad:
        raise InputError(
            f"{file}: cannot be read ({bad.strerror}); give a {FILE} or the folder that holds one"
        ) from None
    except ValueError as bad:
        raise InputError(f"{file}: is not valid JSON ({bad}); write it again") from None
