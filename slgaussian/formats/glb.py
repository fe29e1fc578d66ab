"""Coloured points as binary glTF 2.0 (``.glb``), which modelling programs open.

Centres and colours of Gaussians, without their extent. Axes are glTF's: x right, y up, z backward.
Colours are linear light there, with the opacity as the fourth number; float32, as there are readers
that take no other kind for what it is.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from slgaussian import __version__
from slgaussian.errors import InputError
from slgaussian.formats.written import write_file
from slgaussian.gaussians import SH_C0, Gaussians

_POINTS, _FLOAT, _VERTICES = 0, 5126, 34962


def save_glb(gaussians: Gaussians, path: str | Path, name: str = "scene") -> None:
    """Write the centres of Gaussians as points: complete, or not at all.

    Parameters
    ----------
    gaussians : Gaussians
        At least one.
    path : path
        A file that is there already is replaced.
    name : str
        Of the node that holds the points.

    Raises
    ------
    InputError
        If there is none, a number is NaN, infinite or out of range, or the file cannot be written.
    """
    if not len(gaussians):
        raise InputError(f"{path}: there are no Gaussians to write, expected at least one")
    gaussians.check()
    arrays = gaussians.to_arrays()
    n = len(gaussians)
    points = (arrays["means"] * np.array([1, -1, -1], np.float32)).astype("<f4")
    srgb = (arrays["sh"][:, 0] * np.float32(SH_C0) + np.float32(0.5)).clip(0, 1)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    colours = np.column_stack([linear, arrays["opacities"]]).astype("<f4")
    data = points.tobytes() + colours.tobytes()
    content = {
        "asset": {"version": "2.0", "generator": f"slgaussian {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "mode": _POINTS}]}
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": _FLOAT,
                "count": n,
                "type": "VEC3",
                "min": points.min(0).tolist(),
                "max": points.max(0).tolist(),
            },
            {"bufferView": 1, "componentType": _FLOAT, "count": n, "type": "VEC4"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes, "target": _VERTICES},
            {
                "buffer": 0,
                "byteOffset": points.nbytes,
                "byteLength": colours.nbytes,
                "target": _VERTICES,
            },
        ],
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(content, ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(data)
    write_file(
        path,
        struct.pack("<4sII", b"glTF", 2, length)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(data), b"BIN\0")
        + data,
    )
