"""Files of depth and cameras from other programs: NPZ, PNG, TIFF, NPY, and PFM with JSON.

Values are returned as stored; the caller determines which of several conventions they follow
(:mod:`slgaussian.predict.precomputed`).
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import cv2
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from slgaussian.checks import matching, order_naturally
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.formats.images import MAX_PIXELS, open_image, read_npy, unreadable
from slgaussian.io import short_repr, write_file

ARRAY_NAMES = {
    "depth": ("depth", "depths", "depthmap", "depthmaps", "depth_map", "depth_maps"),
    "confidence": ("conf", "confs", "confidence", "confidences", "depth_conf"),
    "w2c": ("extrinsics", "extrinsic", "w2c", "world_to_camera"),
    "c2w": ("poses", "pose", "c2w", "cam2world", "camera_to_world", "camera_poses"),
    "K": ("intrinsics", "intrinsic", "K", "Ks"),
    "focal": ("focals", "focal"),
    "names": ("names", "image_names", "image_paths"),
}
"""Names of arrays in an NPZ of Depth Anything 3 and of users of VGGT, MapAnything and DUSt3R. The
first name that exists is read."""

VIEW_FILE = re.compile(r"(.*)_view(\d+)\.pfm")
"""Name of the depth of one of several views by depth-anything.cpp, numbered from 0. Beside it is a
JSON file of ``extrinsics`` [3, 4], world-to-camera, and ``intrinsics`` [3, 3], pixels of the map
(https://github.com/mudler/depth-anything.cpp: ``cmd_depth_multi`` in ``examples/cli/main.cpp``)."""

MILLIMETRE = 1e-3  # scene units in one unit of an integer map
MAX_BYTES = 48 * MAX_PIXELS  # largest decompressed size of an NPZ, bytes: 4 GiB
MAX_LEVEL = 2**16 - 1
UNIT_KEY = "slgaussian depth unit"  # text of a PNG: scene units in 1, if no thousandth
DEPTH_ADVICE = (
    "save depth as .npy, .npz, .pfm, .tiff or .png of one number a pixel, of 16 bits or more"
)
WRITABLE_SUFFIXES = (".npy", ".png")  # suffixes that `write_map` supports


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A depth map as stored.

    Attributes:
        file: Name of the file for messages.
        depth: float32 or float64 [h, w]. Along z or along the ray, in any unit; 0 where unknown.
        confidence: float32 [h, w] or None. Higher is more reliable; any range.
        K: float64 [3, 3] or None. Intrinsics in pixels, if the file contains them.
    """

    file: str
    depth: np.ndarray
    confidence: np.ndarray | None = None
    K: np.ndarray | None = None
    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class GeometryFile:
    """Arrays of an NPZ for N photographs.

    Attributes:
        maps: sequence of N DepthMap
        poses: float64 [N, 4, 4] or None
        inverted: Whether the name of the array of poses means world-to-camera.
        names: sequence of N str, or None. Names of the photographs, if the file contains them.
    """

    file: Path
    maps: Sequence[DepthMap]
    poses: np.ndarray | None
    inverted: bool
    names: Sequence[str] | None
    __repr__ = short_repr

    def numbers(self, views: Sequence[str], others: Sequence[str] = ()) -> dict[str, int]:
        """Return the index of the map of each view that has one, by the names of photographs.

        Without names, map i belongs to view i.

        Args:
            views: Names of photographs, in order.
            others: Names of further photographs of the scene.

        Raises:
            InputError: If a name fits two photographs; or, without names, if the numbers of maps
                and views differ, or the order of views depends on how numbers are sorted.
        """
        if self.names is None:
            advice = (
                "give the photographs of that call, in its order"
                if self.file.is_dir()
                else "add an array `names` of theirs, as in np.savez(new, **np.load(old), "
                "names=[...])"
            )
            if len(self.maps) != len(views):
                raise InputError(
                    f"{self.file}: holds {len(self.maps)} maps without names, for {len(views)} "
                    f"photographs; {advice}"
                )
            if list(views) == order_naturally(sorted(views)) != sorted(views):
                raise InputError(
                    f"{self.file}: holds maps without names, for photographs whose order is open: "
                    f"{', '.join(views[:3])}, ..., or {', '.join(sorted(views)[:3])}, ..., as "
                    f"programs sort them; {advice}"
                )
            return {view: i for i, view in enumerate(views)}
        if repeated := [name for name in self.names if list(self.names).count(name) > 1]:
            raise InputError(f"{self.file}: holds two maps named {repeated[0]!r}; rename one")
        numbers = {}
        for view in views:
            name = matching(str(self.file), view, self.names, [*views, *others])
            if name is not None:
                numbers[view] = self.names.index(name)
        return numbers


def numbered_views(folder: Path) -> list[Path]:
    """List the files :data:`VIEW_FILE` in a folder by number; empty if there are none.

    Raises:
        InputError: If the files are of several calls, or a number is missing.
    """
    files = {}
    for file in folder.glob("*_view*.pfm"):
        if (name := VIEW_FILE.fullmatch(file.name)) and file.with_suffix(".json").is_file():
            files[name[1], int(name[2])] = file
    views, prefixes = [files[key] for key in sorted(files)], {prefix for prefix, _ in files}
    if len(prefixes) > 1 or [number for _, number in sorted(files)] != list(range(len(files))):
        raise InputError(
            f"{folder}: holds {', '.join(view.name for view in views[:4])}, expected the views of "
            "one call, numbered from 0"
        )
    return views


def geometry_files(place: Path) -> list[Path]:
    """List the files that :func:`read_geometry` reads."""
    views = numbered_views(place) if place.is_dir() else []
    return [file for view in views for file in (view, view.with_suffix(".json"))] or [place]


def read_geometry(file: Path) -> GeometryFile:
    """Read depth, and optionally confidence and cameras, of several photographs.

    Args:
        file: NPZ with arrays of :data:`ARRAY_NAMES`, or a folder of :func:`numbered_views`.

    Raises:
        InputError: If it cannot be read, contains no depth, or its arrays differ in the number of
            photographs.
    """
    arrays = _read_views(file) if file.is_dir() else _read_npz(file)
    if "depth" not in arrays:
        raise InputError(
            f"{file}: holds no depth; expected one of {', '.join(ARRAY_NAMES['depth'])}"
        )
    depth = _stack_maps(file, "depth", arrays["depth"])
    count, height, width = depth.shape
    confidence = matrices = poses = names = None
    if "confidence" in arrays:
        confidence = _stack_maps(file, "confidence", arrays["confidence"]).astype(np.float32)
        if confidence.shape != depth.shape:
            raise InputError(
                f"{file}: confidence is {confidence.shape}, expected {depth.shape} as depth"
            )
    if "K" in arrays:
        matrices = _check_matrices(file, "intrinsics", arrays["K"], count, (3, 3))
    elif "focal" in arrays:
        focals = arrays["focal"].reshape(-1).astype(np.float64)
        focals = np.broadcast_to(focals, count) if len(focals) == 1 else focals
        matrices = np.array([[[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]] for f in focals])
        matrices = _check_matrices(file, "focals", matrices, count, (3, 3))
    inverted = "w2c" in arrays
    if (stored := arrays.get("w2c", arrays.get("c2w"))) is not None:
        if stored.shape[-2:] == (3, 4):
            last = np.broadcast_to([0.0, 0, 0, 1], (*stored.shape[:-2], 1, 4))
            stored = np.concatenate([stored, last], -2)
        poses = _check_matrices(file, "poses", stored, count, (4, 4))
    if "names" in arrays:
        names = [str(name) for name in arrays["names"].reshape(-1)]
        if len(names) != count:
            raise InputError(f"{file}: has {len(names)} names, expected {count}, one a map")
    maps = [
        DepthMap(
            f"{file} [{i}]",
            known_depth(depth[i]),
            None if confidence is None else confidence[i],
            None if matrices is None else matrices[i],
        )
        for i in range(count)
    ]
    return GeometryFile(file, maps, poses, inverted, names)


def read_map(
    file: Path, byte: bool = False, unit: float = MILLIMETRE, stated: bool = True
) -> np.ndarray:
    """Read a file of one map [h, w]: integers times ``unit``, floating-point values unchanged.

    Args:
        byte: Whether 8-bit integers are allowed, for maps of confidence.
        unit: Value of 1 in integer maps.
        stated: Whether a PNG that :func:`write_map` wrote in another unit than millimetres scales
            ``unit`` accordingly.

    Raises:
        InputError: If it cannot be read, or is not a depth map.
    """
    suffix = file.suffix.lower()
    if suffix == ".npz":
        maps = read_geometry(file).maps
        if len(maps) != 1:
            raise InputError(f"{file}: holds {len(maps)} depth maps, expected that of one view")
        return maps[0].depth
    try:
        if suffix == ".npy":
            pixels = read_npy(file)
        elif suffix == ".pfm":
            pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            if pixels is None:
                raise ValueError("no PFM")
        elif suffix == ".exr":
            raise ValueError("EXR")
        else:
            with open_image(file, kinds=["PNG", "TIFF"]) as image:
                pixels = np.asarray(image)
                if stated:
                    unit *= float(image.info.get(UNIT_KEY, MILLIMETRE)) / MILLIMETRE
    except (OSError, ValueError) as problem:
        raise unreadable(file, problem, DEPTH_ADVICE) from None
    pixels = pixels.squeeze()
    if pixels.ndim != 2 or not pixels.size or pixels.dtype.kind not in "uif" or (
        pixels.dtype.itemsize == 1 and not byte
    ):  # fmt: skip
        raise InputError(
            f"{file}: is {pixels.dtype} {pixels.shape}, expected one number a pixel, of 16 bits "
            "or more"
        )
    return pixels * unit if pixels.dtype.kind in "ui" else pixels


def write_map(file: Path, depth: np.ndarray) -> float:
    """Write z-depth float32 [H, W] as :func:`read_map` reads it, .npy or .png; return the unit.

    A .png has 16 bits, in thousandths of a scene unit, or in the power of ten that holds the depth
    with at least three digits. The latter is written into the file.

    Raises:
        InputError: If the suffix is not supported, or the file cannot be written.
    """
    content, suffix, unit = io.BytesIO(), file.suffix.lower(), 1.0
    if suffix == ".npy":
        np.save(content, depth)
    elif suffix == ".png":
        unit, info, largest = MILLIMETRE, PngInfo(), float(depth.max(initial=0))
        if largest > 0 and not 100 <= largest / unit <= MAX_LEVEL:
            unit = 10.0 ** math.ceil(math.log10(largest / MAX_LEVEL))
        if unit != MILLIMETRE:
            info.add_text(UNIT_KEY, f"{unit:g}")
        pixels = np.rint(depth.astype(np.float64) / unit).astype(np.uint16)
        Image.fromarray(pixels).save(content, "PNG", pnginfo=info)
    else:
        raise InputError(f"{file}: expected the name to end in {', '.join(WRITABLE_SUFFIXES)}")
    write_file(file, content.getvalue())
    return unit


def known_depth(depth: np.ndarray) -> np.ndarray:
    """Return depth as floating-point numbers, with 0 where it is not finite and positive."""
    depth = depth if depth.dtype in (np.float32, np.float64) else depth.astype(np.float32)
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0)


def _read_npz(file: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an NPZ that :data:`ARRAY_NAMES` lists, by its keys."""
    try:
        with ZipFile(file) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > MAX_BYTES:
            raise ValueError(f"{size:,} bytes unpacked, of which at most {MAX_BYTES:,} are read")
        with np.load(file, allow_pickle=False) as stored:
            present = {
                ours: [name for name in names if name in stored]
                for ours, names in ARRAY_NAMES.items()
            }
            return {ours: stored[names[0]] for ours, names in present.items() if names}
    except Exception as problem:  # a damaged archive raises almost anything
        raise unreadable(file, problem, DEPTH_ADVICE) from None


def _read_views(folder: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a folder of :func:`numbered_views`, by keys of :data:`ARRAY_NAMES`."""
    views = numbered_views(folder)
    maps, cameras = [read_map(view) for view in views], []
    for view, depth in zip(views, maps, strict=True):
        file = view.with_suffix(".json")
        if depth.shape != maps[0].shape:
            raise InputError(
                f"{view}: is {depth.shape}, expected {maps[0].shape} as {views[0].name}"
            )
        try:
            content = strict_json.parse(file.read_bytes())
            cameras.append([np.array(content[key], float) for key in ("extrinsics", "intrinsics")])
            if [matrix.shape for matrix in cameras[-1]] != [(3, 4), (3, 3)]:
                raise ValueError("its shapes are others")
        except (OSError, KeyError, TypeError, ValueError) as problem:
            raise InputError(
                f"{file}: holds no extrinsics of 3x4 and intrinsics of 3x3 numbers ({problem}); "
                "copy it again"
            ) from None
    w2c, K = (np.array(matrices) for matrices in zip(*cameras, strict=True))
    return {"depth": np.array(maps), "w2c": w2c, "K": K}


def _stack_maps(file: Path, name: str, values: np.ndarray) -> np.ndarray:
    """Return maps [N, h, w] without the leading and trailing axes of length 1."""
    if values.ndim == 5:  # [1, N, h, w, 1] in VGGT
        values = values[0]
    if values.ndim == 4:
        values = values[..., 0] if values.shape[-1] == 1 else values[0]
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or not values.size or values.dtype.kind not in "uif":
        raise InputError(f"{file}: {name} is {values.dtype} {values.shape}, expected [N, H, W]")
    return values


def _check_matrices(
    file: Path, name: str, values: np.ndarray, count: int, shape: tuple[int, int]
) -> np.ndarray:
    """Return matrices float64 [count, *shape]; InputError for another shape or type."""
    fits = values.dtype.kind in "uif" and values.size == count * shape[0] * shape[1]
    if fits and np.isfinite(values).all():
        return values.reshape(count, *shape).astype(np.float64)
    raise InputError(
        f"{file}: {name} is {values.dtype} {values.shape}, expected finite numbers "
        f"{(count, *shape)}, as many as maps"
    )
