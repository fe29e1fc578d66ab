"""A plain reader of ``.spz`` files, written from the description of the format."""

import gzip
import struct
from pathlib import Path

import numpy as np

from slgaussian.gaussians import Gaussians

AXES = np.array([1, -1, -1], np.float32)
"""From x right, y up, z backward to x right, y down, z forward."""


def load_spz(path: Path) -> Gaussians:
    data = gzip.decompress(path.read_bytes())
    magic, version, n, degree, bits, flags, reserved = struct.unpack_from("<IIIBBBB", data)
    assert (magic, version, flags, reserved) == (0x5053474E, 3, 0, 0)
    terms = (degree + 1) ** 2
    widths = [9, 1, 3, 3, 4, 3 * (terms - 1)]
    ends = 16 + n * np.cumsum(widths)
    assert len(data) == ends[-1]
    means, opacities, colours, scales, quats, higher = (
        np.frombuffer(data, np.uint8, n * width, end - n * width).reshape(n, width)
        for width, end in zip(widths, ends, strict=True)
    )
    fixed = np.zeros((n, 3, 4), np.uint8)
    fixed[..., 1:] = means.reshape(n, 3, 3)  # the sign comes along in the highest byte
    dc = (colours.astype(np.float32) / 255 - np.float32(0.5)) / np.float32(0.15)
    sh = np.concatenate([dc, (higher.astype(np.float32) - 128) / 128], 1).reshape(n, terms, 3)
    # Odd in y, z, or in one of them: https://github.com/nianticlabs/spz, coordinate systems.
    sh[:, 1:] *= np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])[: terms - 1, None]
    xyzw = unpack_quats(np.ascontiguousarray(quats).view("<u4")[:, 0])
    return Gaussians.from_arrays(
        {
            "means": (fixed.view("<i4")[..., 0] >> 8) / np.float32(2**bits) * AXES,
            "scales": np.exp(scales.astype(np.float32) / 16 - 10),
            "quats": (xyzw * np.append(AXES, np.float32(1)))[:, [3, 0, 1, 2]],
            "opacities": opacities[:, 0].astype(np.float32) / 255,
            "sh": sh,
            "source": np.arange(n, dtype=np.int32),
        }
    )


def unpack_quats(packed: np.ndarray) -> np.ndarray:
    """Unit quaternions xyzw float32 [N, 4] of uint32 [N]."""
    largest = (packed >> np.uint32(30)).astype(np.int64)
    codes = packed[:, None] >> np.array([20, 10, 0], np.uint32)
    smaller = (codes & np.uint32(511)).astype(np.float32) / np.float32(511 * np.sqrt(2))
    smaller = np.where(codes & np.uint32(512), -smaller, smaller)
    rows, quats = np.arange(len(packed)), np.empty((len(packed), 4), np.float32)
    columns = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    quats[rows[:, None], columns] = smaller
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - (smaller**2).sum(1)))
    return quats
