"""The compressed ``.spz`` of Niantic, version 3: about 20 bytes a Gaussian before gzip.

As its page says (https://github.com/nianticlabs/spz, MIT licence): after a header of 16 bytes, all
of one attribute and then all of the next, gzipped. Means are fixed-point numbers of 24 bits,
opacities 8 bits, colours of degree 0 in 8 bits (``0.15 sh + 0.5``), scales 8 bits (16 steps a
factor of e, from e^-10), rotations 32 bits, higher harmonics 8 bits, of which degree 1 fills 5 and
the others 4. Its axes are x right, y up, z backward, so y and z are turned here; readers turn them
as they need.

The number of fractional bits of means is as large as the scene allows.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.io import write_file

MAGIC, VERSION = 0x5053474E, 3
COLOUR = 0.15

MOST_BITS = 20
MOST_UNPACKED = 2**30
"""Bytes that a file may unpack to: 16 million Gaussians of degree 3, 53 million of degree 0."""

ANTIALIASED, EXTENDED = 1, 2
"""Flags: trained with anti-aliasing (Yu et al., "Mip-Splatting", CVPR 2024), and followed by
extensions of vendors, one of which changes the axes."""

TURN = np.array([1, -1, -1], np.float32)
"""From x right, y down, z forward to x right, y up, z backward, and back."""

_TURN_SH = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)
"""Signs that :data:`TURN` gives the harmonics 1 to 15: degree 1 holds y, z, x; and so on."""

_MOST = np.float32(511 * np.sqrt(2))
"""Of a component that is not the largest, which is at most 1 / sqrt 2."""

_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def save_spz(gaussians: Gaussians, path: str | Path) -> None:
    """Write Gaussians as ``.spz`` of version 3: complete, or not at all.

    Raises
    ------
    InputError
        If a number is NaN, infinite or out of range, the harmonics are above degree 3, the scene is
        too wide for numbers of 24 bits, or the file cannot be written.
    """
    gaussians.check()
    arrays = gaussians.to_arrays()
    n, terms = arrays["sh"].shape[:2]
    if terms not in (1, 4, 9, 16):
        raise InputError(
            f"gaussians sh: found {terms} coefficients a colour, expected 1, 4, 9 or 16: an .spz "
            "holds harmonics of degree 0 to 3"
        )
    reach = float(np.abs(arrays["means"]).max(initial=1e-6))
    bits = min(MOST_BITS, int(np.floor(np.log2((2**23 - 1) / reach))))
    if bits < 0:
        raise InputError(
            f"gaussians means: found {reach:.3g} scene units from the origin, expected less than "
            "8e6, which an .spz holds; write a .ply"
        )
    fixed = np.rint(arrays["means"] * TURN * 2.0**bits).astype("<i4")
    with np.errstate(divide="ignore"):  # of a scale of 0, which becomes the lowest
        logs = np.log(arrays["scales"])
    quats = arrays["quats"][:, [1, 2, 3, 0]] * np.append(TURN, np.float32(1))
    steps = np.repeat([8, 16], [3, 12])[: terms - 1, None]
    higher = np.rint(arrays["sh"][:, 1:] * _TURN_SH[: terms - 1, None] * 128) + 128
    higher = np.floor((higher + steps // 2) / steps) * steps
    degree = int(np.sqrt(terms)) - 1
    parts = [
        struct.pack("<IIIBBBB", MAGIC, VERSION, n, degree, bits, 0, 0),
        fixed.view(np.uint8).reshape(n, 3, 4)[..., :3].tobytes(),
        _bytes(arrays["opacities"] * 255),
        _bytes((arrays["sh"][:, 0] * np.float32(COLOUR) + 0.5) * 255),
        _bytes((logs + 10) * 16),
        pack_quats(quats).astype("<u4").tobytes(),
        _bytes(higher),
    ]
    write_file(path, gzip.compress(b"".join(parts), 6, mtime=0))


def load_spz(path: str | Path) -> Gaussians:
    """Read an ``.spz`` of version 3 as :func:`save_spz` writes it; sources are numbered from 0.

    Raises
    ------
    InputError
        If the file cannot be read, is no whole ``.spz``, is of another version, has a flag that
        changes how it is drawn, or unpacks to more than :data:`MOST_UNPACKED`.
    """
    try:
        with open(path, "rb") as raw:
            start = raw.read(8)
        if start[:4] == struct.pack("<I", MAGIC) and len(start) == 8:  # not gzipped: from 4 on
            raise _other_version(path, struct.unpack("<I", start[4:])[0])
        with gzip.open(path) as file:
            magic, version, n, degree, bits, flags, _ = struct.unpack("<IIIBBBB", file.read(16))
            if magic == MAGIC and version != VERSION:
                raise _other_version(path, version)
            terms = (degree + 1) ** 2
            wide = [9, 1, 3, 3, 4, 3 * (terms - 1)]
            size = n * sum(wide)
            for wrong, reason in (
                (magic != MAGIC, f"found {magic:#x}, expected an .spz ({MAGIC:#x})"),
                (degree > 3, f"found harmonics of degree {degree}, expected 0 to 3"),
                (bits > 24, f"found {bits} fractional bits, expected at most 24"),
                (
                    flags & ANTIALIASED,
                    "was trained with anti-aliasing (flag 0x1), without which its small Gaussians "
                    "are drawn too thick; train or export it without",
                ),
                (flags == EXTENDED, "has extensions (flag 0x2), which may change its axes"),
                (flags, f"has unknown flags ({flags:#x}), expected none"),
                (
                    size > MOST_UNPACKED,
                    f"unpacks to {size / 2**30:.1f} GiB, of which at most {MOST_UNPACKED >> 30} is "
                    "read; divide it, or convert it to .ply",
                ),
            ):
                if wrong:
                    raise InputError(f"{path}: {reason}")
            data = file.read(size + 1)
    except (OSError, EOFError, zlib.error, struct.error) as error:
        raise InputError(f"{path}: is not a whole .spz file ({error}); write it again") from error
    if len(data) != size:
        amount = "more" if len(data) > size else f"{len(data):,}"
        raise InputError(
            f"{path}: found {amount} bytes of {n:,} Gaussians, expected {size:,}; write it again"
        )
    ends = n * np.cumsum(wide)
    columns = [
        np.frombuffer(data, np.uint8, n * width, end - n * width).reshape(n, width)
        for width, end in zip(wide, ends, strict=True)
    ]
    fixed = np.zeros((n, 3, 4), np.uint8)
    fixed[..., 1:] = columns[0].reshape(n, 3, 3)  # the sign comes along in the highest byte
    means = (fixed.view("<i4")[..., 0] >> 8) / np.float32(2**bits) * TURN
    quats = unpack_quats(np.ascontiguousarray(columns[4]).view("<u4")[:, 0])
    higher = (columns[5].astype(np.float32) - 128) / 128
    dc = (columns[2].astype(np.float32) / 255 - np.float32(0.5)) / np.float32(COLOUR)
    sh = np.concatenate([dc, higher], 1).reshape(n, terms, 3)
    sh[:, 1:] *= _TURN_SH[: terms - 1, None]
    return Gaussians.from_arrays(
        {
            "means": means.astype(np.float32),
            "scales": np.exp(columns[3].astype(np.float32) / 16 - 10),
            "quats": (quats * np.append(TURN, np.float32(1)))[:, [3, 0, 1, 2]],
            "opacities": columns[1][:, 0].astype(np.float32) / 255,
            "sh": sh,
            "source": np.arange(n, dtype=np.int32),
        }
    )


def pack_quats(quats: np.ndarray) -> np.ndarray:
    """Pack quaternions xyzw float32 [N, 4], of any length but zero, into uint32 [N].

    The number of the largest component (2 bits), then of each other one its sign and its size in 9
    bits, in units of 1 / (511 sqrt 2). Rotations come out within a quarter of a degree.
    """
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    largest = np.abs(unit).argmax(1)
    rows = np.arange(len(unit))
    # A quaternion and its negative are one rotation; the largest component is made positive.
    unit = unit * np.where(unit[rows, largest] < 0, -1, 1)[:, None]
    others = unit[rows[:, None], _OTHERS[largest]]
    sizes = np.minimum(np.rint(np.abs(others) * _MOST), 511).astype(np.uint32)
    codes = sizes | ((others < 0).astype(np.uint32) << np.uint32(9))
    packed = largest.astype(np.uint32)
    for column in range(3):
        packed = packed << np.uint32(10) | codes[:, column]
    return packed


def unpack_quats(packed: np.ndarray) -> np.ndarray:
    """Return unit quaternions xyzw float32 [N, 4]; inverse of :func:`pack_quats`."""
    largest = (packed >> np.uint32(30)).astype(np.int64)
    codes = packed[:, None] >> np.array([20, 10, 0], np.uint32)
    sizes = (codes & np.uint32(511)).astype(np.float32) / _MOST
    others = np.where(codes & np.uint32(512), -sizes, sizes)
    quats = np.empty((len(packed), 4), np.float32)
    rows = np.arange(len(packed))
    quats[rows[:, None], _OTHERS[largest]] = others
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - (others**2).sum(1)))
    return quats


def _other_version(path: str | Path, version: int) -> InputError:
    return InputError(
        f"{path}: is an .spz of version {version}, and only version {VERSION} is read; convert it, "
        f"as with `splat-transform {Path(path).name} {Path(path).stem}.ply`, and load the .ply"
    )


def _bytes(values: np.ndarray) -> bytes:
    return np.rint(values).clip(0, 255).astype(np.uint8).tobytes()
