"""A frame of nerfstudio's ``transforms.json``: its camera, lens, photograph, mask and depth.

See :mod:`slgaussian.datasets.nerfstudio`.
"""

from __future__ import annotations

import math
import re
import warnings
from collections import ChainMap
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slgaussian.datasets.intrinsics import checked_camera
from slgaussian.datasets.lens import Maps, perspective_maps
from slgaussian.datasets.photographs import (
    EXTENSIONS,
    is_there,
    masked,
    name_in,
    open_photograph,
    stored_size,
)
from slgaussian.errors import InputError
from slgaussian.formats.images import opened, read_npy, unreadable
from slgaussian.formats.resampling import Window
from slgaussian.scene import Camera, Estimated

PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
FISHEYE = "OPENCV_FISHEYE"
OPENGL = np.array([1.0, -1.0, -1.0, 1.0])
"""Factors of the columns of a pose between OpenCV and OpenGL axes."""

OWN = "slgaussian"
"""Key of this package's additions: at the top level the record of the estimation
(:meth:`slgaussian.cameras.estimated.EstimatedCameras.as_json`), and in each frame the other fields
of a camera (``estimated``, ``near``, ``far``). Such frames refer to upright photographs."""

USED = frozenset(
    ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov")
    + ("camera_model", "is_fisheye", "k1", "k2", "k3", "k4", "p1", "p2", "mask_path")
    + ("depth_unit_scale_factor", "applied_scale")
)
"""Supported keys among those that match :data:`CHANGES_PIXELS`."""

IGNORED = ("aabb_scale", "scale", "auto_scale_poses_override", "integer_depth_scale")
"""Keys without influence on the projection and the image: ``scale`` and ``aabb_scale`` place the
scene in instant-ngp's cube, and ``integer_depth_scale`` belongs to depth that is not read."""

CHANGES_PIXELS = re.compile(
    r"lens|fish|distort|mask|rolling|readout|shutter(?!_?speed)|scale|crop|aspect|flip|skew|shear"
    r"|ortho|rectangular|latlong|pano(?!ptic)|spheri|omnidir|theta|projection|camera_?(model|type)"
    r"|focal|fov|field_of_view|camera_?angle|intrinsic|principal|shift_?[xy]|matrix_(start|end)"
    r"|^f(l?_?[xy])?$|^c_?[xy]$|^[kpsb]_?\d+$|^xi$",
    re.IGNORECASE,
)
"""Parts of key names that indicate a lens, a distortion, a mask, a shutter or a scale."""

NEUTRAL = ("", "none", "pinhole", "perspective", "global")
"""Values of such keys, besides 0, false and null, without effect."""

DEPTH_FILES = (".png", ".npy", ".tif", ".tiff", ".pgm", ".jpg", ".jpeg", ".webp", ".bmp")
"""Supported suffixes of depth files."""

AGREEMENT = 0.01
"""Largest relative difference at which two focal lengths of one axis are equal."""

DEPTH_UNIT = 0.001
"""Scene units in one unit of a depth file without ``depth_unit_scale_factor``."""


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

    def number(self, key: str, default: Any = None) -> Any:
        """Return a finite number as float, or the default if the key is missing."""
        value = self.values.get(key)
        if value is None:
            return default
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise self.error(f"{key} is {value!r}, expected a finite number")
        return float(value)

    @cached_property
    def image_path(self) -> Path | None:
        """Path of the stored photograph; None if it is missing."""
        stem = self.file.parent / self.name
        tries = (stem, *(Path(f"{stem}{end}") for end in EXTENSIONS))
        return next((p for p in tries if is_there(p)), None)

    def stored_size(self) -> tuple[int, int] | None:
        """Return width and height of the stored photograph, None if it cannot be opened."""
        return None if self.image_path is None else stored_size(self.image_path)

    def camera(self, size: tuple[int, int] | None) -> Camera:
        """Return the camera of the undistorted view; ``size`` is used if w and h are missing."""
        self._refuse_unread()
        self._is_fisheye()  # raises for an unsupported model
        w, h = self.number("w"), self.number("h")
        if w is None or h is None:
            if size is None:
                raise self.error("has neither w and h nor a photograph to take them from; add them")
            w, h = size
        if w != int(w) or h != int(h):
            raise self.error(f"w and h are {w:g} and {h:g}, expected whole numbers of pixels")
        fx = self._focal("x", w)
        if fx is None:
            raise self.error("has neither fl_x nor camera_angle_x; add the focal length in pixels")
        fy = self._focal("y", h)
        fy = fx if fy is None else fy
        cx, cy = self.number("cx", w / 2), self.number("cy", h / 2)
        if "transform_matrix" not in self.values:
            raise self.error("has no transform_matrix; add its camera-to-world pose, or remove it")
        try:
            c2w = np.array(self.values["transform_matrix"], np.float64)
        except (TypeError, ValueError):
            raise self.error("transform_matrix is not a 4x4 matrix of numbers") from None
        if c2w.shape != (4, 4):
            raise self.error(f"transform_matrix has shape {c2w.shape}, expected (4, 4)")
        c2w *= OPENGL
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        try:
            camera = checked_camera(Camera(K, c2w, int(w), int(h)))
            if self.extra is None:
                return camera
            extra_frame = Frame.of(self.file, self.name, self.extra)
            near, far, estimate = (
                extra_frame.number("near"),
                extra_frame.number("far"),
                self.extra.get("estimated"),
            )
            estimated = None if estimate is None else Estimated.of(estimate)
            return replace(camera, near=near, far=far, estimated=estimated)
        except InputError as bad:
            raise self.error(str(bad)) from None
        except ValueError as bad:
            raise self.error(f"estimated {bad}") from None

    def _refuse_unread(self) -> None:
        for key, value in self.values.items():
            if key in USED or key in IGNORED or not CHANGES_PIXELS.search(key):
                continue
            is_colour = "mask" in key  # a mask colour of 0 is a value too
            numbers = value if isinstance(value, list) and not is_colour else [value]
            changes_nothing = str(value).lower() in NEUTRAL or not any(numbers)
            if not changes_nothing and not (value == 1 and re.search("scale|aspect", key)):
                raise self.error(
                    f"{key} is {value!r:.60}, which may change where points are seen and is not "
                    "read; undistort the photographs to a PINHOLE camera, or remove the key if it "
                    "does not matter"
                )

    def _focal(self, axis: str, size: float) -> float | None:
        """Return the focal length in pixels along an axis, from the first level that has one."""
        for level in self.values.maps:
            stated = {}
            alone = Frame(self.file, self.name, ChainMap(level))
            for key in (f"fl_{axis}", f"camera_angle_{axis}", f"{axis}_fov"):
                value = alone.number(key)
                if value is None:
                    continue
                if not key.startswith("fl"):
                    angle = math.radians(value) if key.endswith("fov") else value
                    if not 0 < angle < math.pi:
                        unit = "degrees below 180" if key.endswith("fov") else "radians below pi"
                        raise self.error(f"{key} is {value:g}, expected {unit} and above 0")
                    value = size / 2 / math.tan(angle / 2)
                stated[key] = value
            for key, value in stated.items():
                first, expected = next(iter(stated.items()))
                if abs(value - expected) > AGREEMENT * abs(expected):
                    raise self.error(
                        f"{first} says a focal length of {expected:.6g} pixels and {key} one of "
                        f"{value:.6g}; remove the wrong one"
                    )
            if stated:
                return next(iter(stated.values()))
        return None

    def _is_fisheye(self) -> bool:
        """Tell whether the lens is OpenCV's fisheye, by the first level that has the key."""
        for level in self.values.maps:
            model, flag = level.get("camera_model"), level.get("is_fisheye")
            if flag not in (None, True, False):
                raise self.error(f"is_fisheye is {flag!r}, expected true or false")
            if model not in (None, *PERSPECTIVE, FISHEYE):
                raise self.error(
                    f"camera_model {model!r} cannot be read, only {', '.join(PERSPECTIVE)} and "
                    f"{FISHEYE}; undistort the photographs to PINHOLE first"
                )
            if None not in (model, flag) and (model == FISHEYE) != flag:
                raise self.error(
                    f"camera_model is {model} and is_fisheye {flag}, which contradict each other; "
                    "remove the wrong one"
                )
            if model is not None or flag is not None:
                return bool(flag) or model == FISHEYE
        return False

    @property
    def extra(self) -> dict[str, Any] | None:
        """Return the entries of :func:`slgaussian.datasets.nerfstudio.write`, or None."""
        extra = self.values.get(OWN)
        if extra is not None and not isinstance(extra, dict):
            raise self.error(f"{OWN} is {extra!r}, expected an object")
        return extra

    def undistortion(self, camera: Camera) -> Maps | None:
        """Compute undistortion maps (:mod:`slgaussian.datasets.lens`); None for a pinhole."""
        k = [self.number(f"k{i}", 0.0) for i in range(1, 5)]
        p = [self.number(f"p{i}", 0.0) for i in range(1, 3)]
        fisheye = self._is_fisheye()
        if not fisheye and not any((*k, *p)):
            return None
        size = (camera.width, camera.height)
        if fisheye:
            K = camera.K.copy()
            K[:2, 2] -= 0.5  # OpenCV counts from pixel centres
            return cv2.fisheye.initUndistortRectifyMap(
                K, np.array(k), np.eye(3), K, size, cv2.CV_32FC1
            )
        if k[3]:
            raise self.error(
                f"k4 is {k[3]:g}, but a perspective camera has only k1, k2, k3, p1 and p2; set it "
                "to 0 or the camera_model to OPENCV_FISHEYE"
            )
        lens = np.array([k[0], k[1], p[0], p[1], k[2]])
        return perspective_maps(camera.K, size, lens)

    def image(self, path: Path, camera: Camera) -> tuple[np.ndarray, np.ndarray | None]:
        """Open the photograph, uint8 [H, W, 3], and its opaque pixels, bool [H, W] or None."""
        size = (camera.width, camera.height)
        pixels, opaque = open_photograph(path, size, upright=self.extra is not None)
        if pixels.shape[:2] != (camera.height, camera.width):
            raise InputError(
                f"{path}: is {pixels.shape[1]}x{pixels.shape[0]}, but {self.file.name} "
                f"says {camera.width}x{camera.height}; resize it, or scale w, h, fl_x, fl_y, cx "
                "and cy to its size"
            )
        mask = self.values.get("mask_path")
        return (pixels, opaque) if mask is None else masked(pixels, opaque, self.place(mask))

    def place(self, name: Any) -> Path:
        """Resolve a path relative to the folder of the camera file."""
        return self.file.parent / name_in(self.file.parent, str(name))

    def depth(self, camera: Camera) -> np.ndarray | None:
        """Read depth float32 [H, W] in scene units, 0 where unknown; None without a depth file."""
        name = self.values.get("depth_file_path")
        if name is None:
            return None
        path = self.place(name)
        if not is_there(path):
            return None
        if path.suffix.lower() not in DEPTH_FILES:
            warnings.warn(
                f"{path}: is depth of a kind that is not read, and its photograph goes without; "
                "convert it to .npy, or a 16-bit .png in millimetres",
                stacklevel=2,
            )
            return None
        try:
            if path.suffix == ".npy":
                raw = read_npy(path)
            else:
                with opened(path) as image:
                    raw = np.asarray(image)
        except (OSError, ValueError) as bad:
            raise unreadable(path, bad) from None
        raw = raw.squeeze()
        if raw.ndim != 2 or not raw.size or raw.dtype.kind not in "uif":
            raise InputError(
                f"{path}: depth is {raw.dtype} {raw.shape}, expected one number a pixel"
            )
        unit = 1.0
        for key, default in (("depth_unit_scale_factor", DEPTH_UNIT), ("applied_scale", 1.0)):
            factor = self.number(key, default)
            if factor <= 0:
                raise self.error(f"{key} is {factor:g}, expected a positive number")
            unit *= factor
        depth = (raw.astype(np.float64) * unit).astype(np.float32)
        depth[~(np.isfinite(depth) & (depth > 0))] = 0
        photograph = Window.whole(camera.width, camera.height)
        photograph.check_shape(path, *depth.shape[::-1])
        return photograph.depth(depth, camera.height, camera.width)
