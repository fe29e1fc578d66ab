"""Reading and writing of the standard ``.ply`` of 3D Gaussian splatting.

One element ``vertex`` with the property names of the implementation of Kerbl et al., "3D Gaussian
Splatting", 2023: means ``x y z``, normals ``nx ny nz`` (zero, unused), colour
``f_dc_0..2`` and ``f_rest_*`` (coefficients 1 and up of red, then of green, then of blue; see
:mod:`slgaussian.rasterize.harmonics`), ``opacity`` as a logit, ``scale_0..2`` as natural
logarithms, ``rot_0..3`` as wxyz. With degree 3, padded with zeros, these are the 62 columns, 248
bytes a vertex, that some viewers demand exactly. The full form adds columns of this project:
``f_sem_*`` for features, and ``source`` and ``label``. The comment ``origin X Y Z`` is the position
in the world to which the means are relative, where float32 cannot hold them in the world. Integers
are written as floats if that is exact, because some readers assume that every property is a float.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import takewhile
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement
from scipy.special import expit, logit

from slgaussian.errors import InputError, check_type
from slgaussian.formats.writable import check_labels, check_writable
from slgaussian.gaussians import Gaussians
from slgaussian.io import write_file
from slgaussian.scene import local_origin

MIN_LOGIT = -104.0
"""Written for the logit and the logarithm of 0: the largest integer whose sigmoid and exponential
are 0 in float32. Infinity would break viewers and compressors that compute value ranges."""

MAX_LOGIT = 18.0  # written for the logit of 1: the smallest integer whose sigmoid is 1 in float32
REST_COUNTS = (0, 9, 24, 45)  # number of `f_rest_*` columns for degree 0 to 3

_MEANS = ["x", "y", "z"]
_NORMALS = ["nx", "ny", "nz"]
_DC, _SCALES = ([f"{prefix}_{i}" for i in range(3)] for prefix in ("f_dc", "scale"))
_ROTATIONS = [f"rot_{i}" for i in range(4)]
_REQUIRED = [*_MEANS, *_DC, "opacity", *_SCALES, *_ROTATIONS]

DISTORTING = {"filter_3D", "scaling_factor", "trbf_center"}
"""Properties of Mip-Splatting, of Spacetime Gaussians and others by which Gaussians are drawn
otherwise than here."""

MANY = 1000  # Gaussians whose opacities show whether they are logits

_ANTIALIASED = re.compile(
    r"anti.?alias\w*\W+(1|true|yes|on)\b|mode\w*\W+(mip|anti.?alias)", re.IGNORECASE
)
"""Header comments by which Postshot, Brush and others mark training with anti-aliasing:
``postshot.anti_aliasing=1``, ``SplatRenderMode: mip``."""
_NUMBER = r"(-?\d+\.?\d*(?:e[-+]?\d+)?)"


def save_ply(
    gaussians: Gaussians, path: str | Path, labels: np.ndarray | None = None, full: bool = False
) -> None:
    """Write Gaussians atomically as a binary little-endian ``.ply``.

    Args:
        gaussians: With harmonics of degree 0 to 3 in the convention "3dgs". An opacity or a scale
            of 0, and an opacity of 1, are written as finite numbers that are read back as 0 and 1.
            Positions are relative to their origin, which is a comment of the header unless it is
            zero: ``origin X Y Z``. Other programs show them there, and so near zero.
        path: An existing file is replaced.
        labels: int [N], optional. Object of each Gaussian, 0 for none; written if ``full``.
        full: Write the harmonics at their own degree, and then the features as ``f_sem_*``, the
            source pixel as ``source`` and ``labels`` as ``label``; by default the 62 columns of
            3D Gaussian splatting and no others.

    Raises:
        InputError: If a number is NaN, infinite or out of range, the degree is above 3, ``labels``
            have another shape or type, or the file cannot be written.
    """
    check_type(gaussians, Gaussians, "save_ply: expected Gaussians, and then a path")
    check_writable(gaussians, "a .ply")
    arrays, n = gaussians.to_arrays(), len(gaussians)
    sh = arrays["sh"]
    if not full:
        sh = np.pad(sh, ((0, 0), (0, 16 - sh.shape[1]), (0, 0)))
    rest = sh.shape[1] - 1
    with np.errstate(divide="ignore"):  # log of 0; MIN_LOGIT is written instead
        logits = logit(arrays["opacities"].astype(np.float64)).clip(MIN_LOGIT, MAX_LOGIT)
        logs = np.log(arrays["scales"].astype(np.float64)).clip(MIN_LOGIT)
    groups = [
        (_MEANS, arrays["means"]),
        (_NORMALS, np.zeros((n, 3))),
        (_DC, sh[:, 0]),
        *(([f"f_rest_{c * rest + i}" for i in range(rest)], sh[:, 1:, c]) for c in range(3)),
        (["opacity"], logits[:, None]),
        (_SCALES, logs),
        (_ROTATIONS, arrays["quats"]),
    ]
    columns = {
        name: column
        for names, values in groups
        for name, column in zip(names, values.T, strict=True)
    }
    integers = {}
    if full:
        features = arrays.get("features", np.empty((n, 0)))
        columns |= {f"f_sem_{i}": column for i, column in enumerate(features.T)}
        integers["source"] = arrays["source"]
    if full and labels is not None:
        integers["label"] = check_labels(labels, n)
    kinds = dict.fromkeys(columns, "<f4")
    for name, values in integers.items():
        kinds[name] = "<f4" if np.array_equal(values.astype("<f4"), values) else "<i4"
    table = np.empty(n, list(kinds.items()))
    for name, column in (columns | integers).items():
        table[name] = column
    buffer = io.BytesIO()
    position = " ".join(map(repr, gaussians.origin.tolist()))
    comments = [f"origin {position}"] if gaussians.origin.any() else []
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<", comments=comments).write(buffer)
    write_file(path, buffer.getbuffer())


def load_ply(path: str | Path) -> tuple[Gaussians, dict[str, np.ndarray]]:
    """Read a ``.ply`` of Gaussians from any program.

    It may be ASCII or binary of either byte order, with columns of any numeric type in any order.
    Doubles that float32 cannot hold as positions get a local origin. Missing ``f_rest_*`` mean
    view-independent colours; without an integer ``source`` the Gaussians are numbered from 0.
    Rotations are normalised, normals and degrees of only zeros are dropped, and infinite logits
    give opacities 0 and 1. Opacities that all are from 0 to 1, as MVSplat and pixelSplat write
    them, are no logits, and a warning says so.

    Returns:
        gaussians: Gaussians. In float32. :func:`save_ply` rounds logits and logarithms: opacities
            have an error of at most 6e-8, scales a relative error of at most 6e-8 times (1 +
            abs(log(scale))).
        extra: dict of str to [N]. Every other property by name, in its stored type, such as ids and
            features of objects; ``label`` as int32 if its values are integers.

    Raises:
        InputError: If the file is missing, not a ``.ply``, truncated, lacks properties of Gaussians
            (such as a point cloud), has a comment or property that demands another rendering, or
            contains an invalid number; the message names the file and the property or vertex.
    """
    table, comments = _vertices(path)
    n = len(table)
    # A list property is not a numeric column; it can only be extra.
    fields = table.dtype.names or ()
    names = [name for name in fields if table.dtype[name].kind != "O"]
    if "packed_position" in names:
        raise InputError(
            f"{path}: is a compressed .ply of PlayCanvas; convert it, as by `npx "
            f"@playcanvas/splat-transform {Path(path).name} plain.ply`"
        )
    if {"scale_0", "scale_1"} <= set(names) and "scale_2" not in names:
        raise InputError(
            f"{path}: holds 2D Gaussians, which have no scale_2; expected 3D Gaussian splatting"
        )
    if missing := [name for name in _REQUIRED if name not in names]:
        raise InputError(
            f"{path}: holds no Gaussians: lacks {_some(missing)} and has {_some(names)}; expected "
            "plain 3D Gaussian splatting, not points or a mesh"
        )
    rest, semantic = _consecutive_names(names, "f_rest_"), _consecutive_names(names, "f_sem_")
    if len(rest) not in REST_COUNTS:
        raise InputError(
            f"{path}: has {len(rest)} properties f_rest_*, expected one of "
            f"{', '.join(map(str, REST_COUNTS))}; write it again with harmonics of degree 0 to 3"
        )
    if distorting := [
        *sorted(DISTORTING.intersection(fields)),
        *filter(_ANTIALIASED.search, comments),
    ]:
        raise InputError(
            f"{path}: has {_some(distorting)}, by which its Gaussians are drawn otherwise than "
            "here; export it as plain 3D Gaussian splatting"
        )
    origin = _origin(comments)
    if len(table) and all(table.dtype[name] == np.float64 for name in _MEANS):
        means = np.stack([table[name] for name in _MEANS], 1).astype(np.float64)
        # What float32 cannot hold at all is refused below.
        shift = local_origin(means) if np.abs(means).max() < 1e30 else np.zeros(3)
        if shift.any():
            table = table.copy()
            for name, column in zip(_MEANS, (means - shift).T, strict=True):
                table[name] = column
            origin = origin + shift
    read = partial(_finite, path, table)
    quats = read(_ROTATIONS).astype(np.float64)
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    if not lengths.all():
        raise InputError(
            f"{path}: vertex {int(np.argmin(lengths))} has the rotation (0, 0, 0, 0), which is "
            "none; remove it, or write the file again"
        )
    higher = read(rest).reshape(n, 3, len(rest) // 3).mT
    # A degree that is only padding costs time in every rendering.
    while higher.shape[1]:
        lower = math.isqrt(higher.shape[1]) ** 2 - 1
        if higher[:, lower:].any():
            break
        higher = higher[:, :lower]
    sh = np.empty((n, 1 + higher.shape[1], 3), np.float32)
    sh[:, 0], sh[:, 1:] = read(_DC), higher
    source = _whole(table["source"]) if "source" in names else None
    arrays = {
        "means": read(_MEANS),
        "scales": read(_SCALES, np.exp),
        "quats": (quats / lengths).astype(np.float32),
        "opacities": read(["opacity"], None if _are_opacities(path, table) else expit)[:, 0],
        "sh": sh,
        "source": np.arange(n, dtype=np.int32) if source is None else source,
    }
    if semantic:
        arrays["features"] = read(semantic)
    used = {*_REQUIRED, *_NORMALS, *rest, *semantic, *(["source"] if source is not None else [])}
    # Copied in native byte order; the file is only memory-mapped.
    extra = {
        name: np.array(table[name], table.dtype[name].newbyteorder("="))
        for name in fields
        if name not in used
    }
    if "label" in names and (label := _whole(extra["label"])) is not None:
        extra["label"] = label
    return replace(Gaussians.from_arrays(arrays), origin=origin), extra


def _origin(comments: Sequence[str]) -> np.ndarray:
    """Return the origin in the comment of :func:`save_ply`, float64 [3], zero without one."""
    for line in comments:
        if match := re.fullmatch(rf"origin {_NUMBER} {_NUMBER} {_NUMBER}", line.strip()):
            return np.array(match.groups(), np.float64)
    return np.zeros(3)


def _are_opacities(path: str | Path, table: np.ndarray) -> bool:
    """Return whether a file has opacities instead of their logits, and warn if so.

    As logits of many Gaussians, numbers of which none is below 0 or above 1 but some are far apart
    would be opacities that fill .5 to .73.
    """
    opacity = table["opacity"]
    if len(table) < MANY:
        return False
    linear = opacity.min() >= 0 and opacity.max() <= 1 and np.ptp(opacity) > 0.5
    if linear:
        warnings.warn(
            f"{path}: has opacities from {opacity.min():.2g} to {opacity.max():.2g}, as MVSplat "
            "and pixelSplat write them, where logits are expected; taken as they are",
            stacklevel=3,
        )
    return bool(linear)


def _finite(
    path: str | Path,
    table: np.ndarray,
    names: Sequence[str],
    convert: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Stack columns, converted in float64, as finite float32 [N, len(names)]; else InputError."""
    values = np.empty((len(table), len(names)), np.float32)
    with np.errstate(over="ignore"):  # overflow gives infinity, which is refused below
        for column, name in enumerate(names):
            raw = table[name]
            values[:, column] = convert(raw.astype(np.float64)) if convert else raw
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise InputError(
            f"{path}: vertex {row} has {names[column]} {table[names[column]][row]}, which makes no "
            "Gaussian; remove it, or write the file again"
        )
    return values


def _vertices(path: str | Path) -> tuple[np.ndarray, list[str]]:
    """Read the vertex table of a file and the comments in its header."""
    try:
        data = PlyData.read(str(path))
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{path}: cannot be read ({why}); give a .ply file") from error
    except Exception as error:  # a damaged file raises almost anything
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"{path}: is not a whole .ply file ({reason}); copy or write it again"
        ) from error
    if "vertex" not in data:
        elements = _some([element.name for element in data])
        raise InputError(
            f"{path}: has no element vertex, only {elements}; give a .ply of Gaussians"
        )
    return data["vertex"].data, [*data.comments, *data.obj_info, *data["vertex"].comments]


def _consecutive_names(names: Sequence[str], prefix: str) -> list[str]:
    """Return the names ``prefix`` + 0, 1, ... up to the first gap."""
    return list(takewhile(set(names).__contains__, (f"{prefix}{i}" for i in range(len(names)))))


def _whole(values: np.ndarray) -> np.ndarray | None:
    """Return integer values of any type as int32 [N]; None if some are not integers."""
    with np.errstate(invalid="ignore"):  # NaN and overflow differ after the conversion
        integers = values.astype(np.int32)
    return integers if np.array_equal(integers, values) else None


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
