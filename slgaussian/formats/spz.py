"""The compressed ``.spz`` of Niantic, version 3: about 20 bytes per Gaussian before gzip.

Format (https://github.com/nianticlabs/spz, MIT licence): a header of 16 bytes, then one attribute
of all Gaussians after the other, gzipped. Means are 24-bit fixed-point numbers, opacities 8 bits,
colours of degree 0 8 bits (``0.15 sh + 0.5``), scales 8 bits (16 steps per factor of e, from
e^-10), rotations 32 bits, higher harmonics 8 bits, of which degree 1 uses 5 and the others 4. The
axes are x right, y up, z backward (:func:`slgaussian.formats.axes.turn_axes`).

The number of fractional bits of the means is the largest that the extent of the scene allows.
"""

from __future__ import annotations

import gzip
import struct
import warnings
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.axes import turn_axes
from slgaussian.gaussians import Gaussians
from slgaussian.io import write_file

MAGIC, VERSION = 0x5053474E, 3
COLOUR_SCALE = 0.15

MAX_BITS = 20  # largest number of fractional bits of the means

MIN_SCALE, MAX_SCALE = np.exp(-10.0), np.exp(255 / 16 - 10)
"""Smallest and largest scale, scene units."""

_QUATERNION_SCALE = np.float32(511 * np.sqrt(2))
"""Scale of the three smaller components, whose magnitude is at most 1 / sqrt 2."""

_STORED_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def save_spz(gaussians: Gaussians, path: str | Path, labels: np.ndarray | None = None) -> None:
    """Write Gaussians atomically as ``.spz`` of version 3, which has no place for ``labels``.

    Raises:
        InputError: If a number is NaN, infinite or out of range, the harmonics are above degree 3,
            the scene is too large for 24-bit means, its unit does not suit 8-bit scales, or the
            file cannot be written.
    """
    gaussians.check()
    arrays = turn_axes(gaussians).to_arrays()
    n, terms = arrays["sh"].shape[:2]
    if terms not in (1, 4, 9, 16):
        raise InputError(
            f"gaussians sh: found {terms} coefficients a colour, expected 1, 4, 9 or 16: an .spz "
            "holds harmonics of degree 0 to 3"
        )
    reach = float(np.abs(arrays["means"]).max(initial=1e-6))
    bits = min(MAX_BITS, int(np.floor(np.log2((2**23 - 1) / reach))))
    if bits < 0:
        raise InputError(
            f"gaussians means: found {reach:.3g} scene units from the origin, expected less than "
            "8e6, which an .spz holds; write a .ply"
        )
    fixed = np.rint(arrays["means"] * 2.0**bits).astype("<i4")
    with np.errstate(divide="ignore"):  # log of a scale of 0, clipped to the smallest value
        logs = np.log(arrays["scales"])
    middle = float(np.median(arrays["scales"])) if n else 1.0
    if not MIN_SCALE <= middle <= MAX_SCALE:
        raise InputError(
            f"gaussians scales: found half of them {'below' if middle < 1 else 'above'} "
            f"{middle:.2g} scene units, expected {MIN_SCALE:.2g} to {MAX_SCALE:.2g}, which an .spz "
            "holds; write a .ply, or give cameras in another unit"
        )
    if gaussians.origin.any():
        position = ", ".join(map(repr, gaussians.origin.tolist()))
        warnings.warn(
            f"{path}: an .spz has no place for the origin of its positions in the world, "
            f"({position}); a .ply keeps it",
            stacklevel=2,
        )
    quats = arrays["quats"][:, [1, 2, 3, 0]]
    steps = np.repeat([8, 16], [3, 12])[: terms - 1, None]
    higher = np.rint(arrays["sh"][:, 1:] * 128) + 128
    higher = np.floor((higher + steps // 2) / steps) * steps
    degree = int(np.sqrt(terms)) - 1
    parts = [
        struct.pack("<IIIBBBB", MAGIC, VERSION, n, degree, bits, 0, 0),
        fixed.view(np.uint8).reshape(n, 3, 4)[..., :3].tobytes(),
        _bytes(arrays["opacities"] * 255),
        _bytes((arrays["sh"][:, 0] * np.float32(COLOUR_SCALE) + 0.5) * 255),
        _bytes((logs + 10) * 16),
        pack_quats(quats).astype("<u4").tobytes(),
        _bytes(higher),
    ]
    write_file(path, gzip.compress(b"".join(parts), 6, mtime=0))


def pack_quats(quats: np.ndarray) -> np.ndarray:
    """Pack quaternions xyzw float32 [N, 4], of any length but zero, into uint32 [N].

    The index of the largest component (2 bits), then sign and 9-bit magnitude of each other
    component in units of 1 / (511 sqrt 2). The rotation error is below 0.28 degrees.
    """
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    largest = np.abs(unit).argmax(1)
    rows = np.arange(len(unit))
    # A quaternion and its negative are the same rotation; the largest component is made positive.
    unit = unit * np.where(unit[rows, largest] < 0, -1, 1)[:, None]
    smaller = unit[rows[:, None], _STORED_COMPONENTS[largest]]
    sizes = np.minimum(np.rint(np.abs(smaller) * _QUATERNION_SCALE), 511).astype(np.uint32)
    codes = sizes | ((smaller < 0).astype(np.uint32) << np.uint32(9))
    packed = largest.astype(np.uint32)
    for code in codes.T:
        packed = packed << np.uint32(10) | code
    return packed


def _bytes(values: np.ndarray) -> bytes:
    return np.rint(values).clip(0, 255).astype(np.uint8).tobytes()
