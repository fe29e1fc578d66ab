"""The compressed ``.spz`` of Niantic: about 20 bytes per Gaussian before compression.

Format (https://github.com/nianticlabs/spz, MIT licence): a header of 16 bytes, then one attribute
of all Gaussians after the other, gzipped. Means are 24-bit fixed-point numbers, opacities 8 bits,
colours of degree 0 8 bits (``0.15 sh + 0.5``), scales 8 bits (16 steps per factor of e, from
e^-10), rotations 32 bits, higher harmonics 8 bits, of which degree 1 uses 5 and the others 4. The
axes are x right, y up, z backward (:func:`slgaussian.formats.axes.turn_axes`).

That is version 3, which is written here; the number of fractional bits of the means is the largest
that the extent of the scene allows. Version 2 has rotations of 24 bits. Version 4 has a header of
32 bytes and a table of sizes, and each attribute is compressed apart, by zstd.
"""

from __future__ import annotations

import gzip
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa

from slgaussian.errors import InputError
from slgaussian.formats.axes import turn_axes
from slgaussian.formats.writable import check_writable
from slgaussian.gaussians import Gaussians
from slgaussian.io import write_file

MAGIC, VERSION = 0x5053474E, 3
READABLE_VERSIONS = (2, 3, 4)
ANTIALIASED, EXTENDED = 1, 2  # flags
ORBIT_LIMITS = 0xADBE0002  # the extension that only limits the cameras of a viewer
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
    check_writable(gaussians, "an .spz")
    arrays = turn_axes(gaussians).to_arrays()
    n, terms = arrays["sh"].shape[:2]
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


def load_spz(path: str | Path) -> tuple[Gaussians, dict[str, np.ndarray]]:
    """Read an ``.spz`` of version 2, 3 or 4 from any program.

    Returns:
        gaussians: Gaussians. In float32, numbered from 0.
        extra: dict. Empty: an ``.spz`` has no further columns.

    Raises:
        InputError: If the file is missing, not an ``.spz``, truncated, of another version or above
            degree 3, or if a flag or an extension demands another reading or rendering.
    """
    bits, (means, opacities, colours, scales, quats, higher) = _read(path)
    n = len(means)
    fixed = np.zeros((n, 3, 4), np.uint8)
    fixed[..., 1:] = means.reshape(n, 3, 3)  # the sign comes along in the highest byte
    dc = (colours.astype(np.float32) / 255 - np.float32(0.5)) / np.float32(COLOUR_SCALE)
    sh = np.concatenate([dc, (higher.astype(np.float32) - 128) / 128], 1)
    gaussians = Gaussians.from_arrays(
        {
            "means": (fixed.view("<i4")[..., 0] >> 8).astype(np.float32) / np.float32(2**bits),
            "scales": np.exp(scales.astype(np.float32) / 16 - 10),
            "quats": unpack_quats(quats)[:, [3, 0, 1, 2]],
            "opacities": opacities[:, 0].astype(np.float32) / 255,
            "sh": sh.reshape(n, sh.shape[1] // 3, 3),
            "source": np.arange(n, dtype=np.int32),
        }
    )
    return turn_axes(gaussians), {}


def _read(path: str | Path) -> tuple[int, list[np.ndarray]]:
    """Return the fractional bits of the means, and the six attributes, each uint8 [N, width]."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{path}: cannot be read ({why}); give an .spz file") from error
    try:
        data = gzip.decompress(data) if data.startswith(b"\x1f\x8b") else data
        magic, version, n, degree, bits, flags, _ = struct.unpack("<IIIBBBB", data[:16])
        if magic != MAGIC or bits > 24:
            raise ValueError("its header is none")
        for found, refused in (
            (f"version {version}", version not in READABLE_VERSIONS),
            (f"harmonics of degree {degree}", degree > 3),
            (f"the flags {flags:#x}", flags & ~(ANTIALIASED | EXTENDED)),
        ):
            if refused:
                raise InputError(
                    f"{path}: has {found}, expected an .spz of version 2, 3 or 4 with harmonics of "
                    "degree 0 to 3; write it again as such"
                )
        widths = [9, 1, 3, 3, 3 if version == 2 else 4, 3 * (degree + 1) ** 2 - 3]
        *streams, extensions = _split(data, version, [n * width for width in widths])
        if flags & EXTENDED:
            _check_extensions(path, extensions)
        elif extensions:
            raise ValueError(f"found {len(extensions)} bytes too many")
    except InputError:
        raise
    except (OSError, EOFError, MemoryError, ValueError, zlib.error, struct.error) as error:
        raise InputError(
            f"{path}: is not a whole .spz file ({error or 'too large'}); copy or write it again"
        ) from error
    if flags & ANTIALIASED:
        raise InputError(
            f"{path}: is marked as trained with anti-aliasing, by which its Gaussians are drawn "
            "otherwise than here; export it as plain 3D Gaussian splatting"
        )
    return bits, [
        np.frombuffer(stream, np.uint8).reshape(n, width)
        for stream, width in zip(streams, widths, strict=True)
    ]


def _split(data: bytes, version: int, sizes: list[int]) -> list[bytes]:
    """Return the attributes of ``sizes`` bytes each, and the extensions; else ValueError."""
    if version < 4:
        ends = 16 + np.cumsum([0, *sizes])
        if len(data) < ends[-1]:
            raise ValueError(f"found {len(data)} bytes, expected {ends[-1]}")
        return [data[a:b] for a, b in zip(ends, [*ends[1:], len(data)], strict=True)]
    count, table = struct.unpack_from("<BI", data, 15)
    start = table + 16 * count
    stored = iter([struct.unpack_from("<QQ", data, table + 16 * i) for i in range(count)])
    parts = []
    for size in sizes:
        length, unpacked = next(stored, (0, 0)) if size else (0, 0)  # empty ones are left out
        if unpacked != size or start + length > len(data):
            raise ValueError(f"found a part of {unpacked} bytes, expected {size}")
        packed = memoryview(data)[start : start + length]
        parts.append(pa.decompress(packed, size, "zstd", asbytes=True) if size else b"")
        start += length
    if start != len(data):
        raise ValueError(f"found {len(data)} bytes, expected {start}")
    return [*parts, data[32:table]]


def _check_extensions(path: str | Path, records: bytes) -> None:
    """Refuse extensions that may change the meaning of the numbers, such as other axes."""
    while records:
        kind, length = struct.unpack_from("<II", records)
        if kind != ORBIT_LIMITS:
            raise InputError(
                f"{path}: has the extension {kind:#x}, which may change what its numbers mean; "
                "write it again without extensions"
            )
        records = records[8 + length :]


def pack_quats(quats: np.ndarray) -> np.ndarray:
    """Pack quaternions xyzw float32 [N, 4], of any length but zero, into uint32 [N].

    The index of the largest component (2 bits), then sign and 9-bit magnitude of each other
    component in units of 1 / (511 sqrt 2). The rotation error is below 0.28 degrees.
    """
    largest, smaller = drop_largest(quats)
    sizes = np.minimum(np.rint(np.abs(smaller) * _QUATERNION_SCALE), 511).astype(np.uint32)
    codes = sizes | ((smaller < 0).astype(np.uint32) << np.uint32(9))
    packed = largest.astype(np.uint32)
    for code in codes.T:
        packed = packed << np.uint32(10) | code
    return packed


def unpack_quats(packed: np.ndarray) -> np.ndarray:
    """Return unit quaternions xyzw float32 [N, 4] from uint8 [N, 4], or [N, 3] of version 2.

    Those of 4 bytes are packed by :func:`pack_quats`, little-endian; those of 3 bytes hold x, y and
    z, 127.5 (component + 1), and w is positive.
    """
    quats, rows = np.empty((len(packed), 4), np.float32), np.arange(len(packed))
    smaller: np.ndarray
    if packed.shape[1] == 3:
        largest = np.full(len(packed), 3)
        smaller = packed / np.float32(127.5) - 1
    else:
        words = np.ascontiguousarray(packed).view("<u4")
        largest = (words[:, 0] >> np.uint32(30)).astype(np.int64)
        codes = words >> np.array([20, 10, 0], np.uint32)
        smaller = (codes & np.uint32(511)).astype(np.float32) / _QUATERNION_SCALE
        smaller = np.where(codes & np.uint32(512), -smaller, smaller)
    quats[rows[:, None], _STORED_COMPONENTS[largest]] = smaller
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - (smaller**2).sum(1)))
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def drop_largest(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the largest component of [N, 4], and the others at unit length [N, 3]."""
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    largest = np.abs(unit).argmax(1)
    rows = np.arange(len(unit))
    # A quaternion and its negative are the same rotation; the largest component is made positive.
    unit = unit * np.where(unit[rows, largest] < 0, -1, 1)[:, None]
    return largest, unit[rows[:, None], _STORED_COMPONENTS[largest]]


def _bytes(values: np.ndarray) -> bytes:
    return np.rint(values).clip(0, 255).astype(np.uint8).tobytes()
