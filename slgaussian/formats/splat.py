"""The ``.splat`` of the viewer of antimatter15, which many others open: 32 bytes a Gaussian.

Mean and scales as float32, colour and opacity as 8 bits, the rotation wxyz as 8 bits a component
around 128, little-endian, without a header; see https://github.com/antimatter15/splat. Colour is
that of degree 0: what depends on the viewpoint is lost. The largest come first, so that viewers
which load bit by bit show something early.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.written import write_file
from slgaussian.gaussians import SH_C0, Gaussians

ROW = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)]
)  # 32 bytes


def save_splat(gaussians: Gaussians, path: str | Path) -> None:
    """Write Gaussians as ``.splat``: complete, or not at all.

    Raises
    ------
    InputError
        If a number is NaN, infinite or out of range, or the file cannot be written.
    """
    gaussians.check()
    arrays = gaussians.to_arrays()
    quats = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    colours = arrays["sh"][:, 0] * np.float32(SH_C0) + np.float32(0.5)
    table = np.empty(len(gaussians), ROW)
    table["mean"], table["scale"] = arrays["means"], arrays["scales"]
    table["rgba"][:, :3] = np.rint(colours.clip(0, 1) * 255)
    table["rgba"][:, 3] = np.rint(arrays["opacities"] * 255)
    table["rotation"] = np.rint(quats * 128 + 128).clip(0, 255)
    weight = arrays["scales"].prod(1) * arrays["opacities"]
    write_file(path, table[np.argsort(-weight, kind="stable")].tobytes())


def load_splat(path: str | Path) -> Gaussians:
    """Read a ``.splat``; sources are numbered from 0.

    Raises
    ------
    InputError
        If the file cannot be read, is no whole number of Gaussians, or holds one that is none.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give a .splat file"
        ) from error
    if not data or len(data) % ROW.itemsize:
        raise InputError(
            f"{path}: found {len(data)} bytes, expected a multiple of {ROW.itemsize}, above 0; "
            "copy or write the .splat again"
        )
    table = np.frombuffer(data, ROW)
    rgba = table["rgba"].astype(np.float32) / 255
    gaussians = Gaussians.from_arrays(
        {
            "means": table["mean"],
            "scales": table["scale"],
            "quats": (table["rotation"].astype(np.float32) - 128) / 128,
            "opacities": rgba[:, 3],
            "sh": ((rgba[:, :3] - 0.5) / np.float32(SH_C0))[:, None],
            "source": np.arange(len(table), dtype=np.int32),
        }
    )
    try:
        gaussians.check()
    except InputError as error:
        raise InputError(f"{path}: {error}; copy or write the .splat again") from error
    return gaussians
