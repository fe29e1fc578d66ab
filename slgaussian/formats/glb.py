"""A ``.glb`` with KHR_gaussian_splatting: Gaussians as points of glTF 2.0.

Format (https://github.com/KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting,
ratified): attributes of a primitive of points. Scales and opacities are stored as they are,
rotations as xyzw, harmonics by degree and number for all three colours together. ``COLOR_0`` is
what programs without the extension draw. The axes are x right, y up, z backward
(:func:`slgaussian.formats.axes.turn_axes`).

All Gaussians are one node, since three.js orders only those within a node by depth: a node for each
object would be drawn through those in front of it. The object of each is the attribute ``_LABEL``.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.formats.axes import turn_axes
from slgaussian.formats.writable import check_labels, check_writable
from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.io import write_file

EXTENSION = "KHR_gaussian_splatting"
SPLATS = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
COMPONENTS = {"float32": 5126, "uint8": 5121}
ARRAY_BUFFER, POINTS = 34962, 0


def save_glb(
    gaussians: Gaussians,
    path: str | Path,
    labels: np.ndarray | None = None,
    names: Mapping[int, str] | None = None,
) -> None:
    """Write Gaussians atomically as ``.glb``.

    Args:
        labels: int [N], optional. Object of each Gaussian, 0 for none; the attribute ``_LABEL``.
        names: {label: str}, optional. Names of the objects, in the ``extras`` of the node.

    Raises:
        InputError: If there are no Gaussians, a number is NaN, infinite or out of range, the
            harmonics are above degree 3, ``labels`` have another shape or type, or the file cannot
            be written.
    """
    check_writable(gaussians, "a .glb", least=1)
    turned = turn_axes(gaussians)
    attributes = _compute_attributes(turned)
    if labels is not None:
        # glTF allows no integers of 32 bits in attributes of an application.
        attributes["_LABEL"] = check_labels(labels, len(gaussians)).astype(np.float32)[:, None]
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    offset = 0
    for name, values in attributes.items():
        accessors.append(
            {
                "bufferView": len(views),
                "componentType": COMPONENTS[values.dtype.name],
                "count": len(values),
                "type": TYPES[values.shape[1]],
            }
        )
        if values.dtype == np.uint8:
            accessors[-1]["normalized"] = True
        if name == "POSITION":
            accessors[-1] |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        view = {"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes}
        views.append({**view, "target": ARRAY_BUFFER})
        offset += values.nbytes
    primitive = {
        "attributes": {name: index for index, name in enumerate(attributes)},
        "mode": POINTS,
        "extensions": {EXTENSION: SPLATS},
    }
    extras = {"origin": (turned.origin + 0).tolist(), "objects": dict(names or {})}
    about = {
        "asset": {"version": "2.0", "generator": "SLGaussian"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "extras": extras}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    parts = [
        struct.pack("<4sII", b"glTF", 2, 28 + len(text) + offset),
        struct.pack("<I4s", len(text), b"JSON"),
        text,
        struct.pack("<I4s", offset, b"BIN\0"),
        *(values.tobytes() for values in attributes.values()),
    ]
    write_file(path, b"".join(parts))


def _compute_attributes(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Return the attributes [N, 1, 3 or 4] of Gaussians in the axes of glTF, by name."""
    arrays = gaussians.to_arrays()
    quats, sh = arrays["quats"][:, [1, 2, 3, 0]].astype(np.float64), arrays["sh"]
    opacities = arrays["opacities"][:, None]
    bytes_ = np.rint(np.concatenate([sh[:, 0] * SH_C0 + 0.5, opacities], 1).clip(0, 1) * 255)
    degrees = [math.isqrt(term) for term in range(sh.shape[1])]
    attributes = {
        "POSITION": arrays["means"],
        "COLOR_0": bytes_.astype(np.uint8),
        f"{EXTENSION}:ROTATION": quats / np.linalg.norm(quats, axis=1, keepdims=True),
        f"{EXTENSION}:SCALE": arrays["scales"],
        f"{EXTENSION}:OPACITY": opacities,
    } | {
        f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{term - degree**2}": sh[:, term]
        for term, degree in enumerate(degrees)
    }
    return {
        name: np.ascontiguousarray(values, None if name == "COLOR_0" else np.float32)
        for name, values in attributes.items()
    }
