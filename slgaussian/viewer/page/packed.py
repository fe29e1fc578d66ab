"""Gaussians in 21 bytes each, before gzip, as the page unpacks them (``data.js``).

Neighbours in space follow each other (Morton order), in blocks whose means are 16 bits an axis
within the block's box. Scales are 10 bits each, in equal steps of their logarithm; rotations 32
bits (:func:`slgaussian.formats.spz.pack_quats`); colours of degree 0 and opacities 8 bits.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.spz import pack_quats
from slgaussian.gaussians import SH_C0, Gaussians

BLOCK = 256
"""Gaussians whose means share a box."""

MOST_THINGS = 2**16 - 1
SMALLEST = 1e-7
"""The least scale that is kept, as a part of the greatest."""

Layout = dict[str, tuple[str, int, int]]
"""Of each array by name: its kind (u1, u4, f4), offset in bytes, and count."""


@dataclass(frozen=True, eq=False)
class Packed:
    """Bytes that the page unpacks.

    Attributes
    ----------
    data : bytes
        Gzipped.
    layout : Layout
    scale_logs : (float, float)
        Logarithm of the scale that code 0 stands for, and the step from code to code.
    """

    data: bytes
    layout: Layout
    scale_logs: tuple[float, float]


def packed(gaussians: Gaussians, things: np.ndarray, level: int = 9) -> Packed:
    """Pack Gaussians that belong to ``things`` int [N]: from 1, 0 for none.

    ``level`` is that of gzip: 1 takes a tenth of the time of 9, for some 5% more bytes.

    Raises
    ------
    InputError
        If there are no Gaussians, one of them makes no sense, or there are too many things.
    """
    if not len(gaussians):
        raise InputError("there are no Gaussians to show, expected at least one")
    gaussians.check()
    if things.max(initial=0) > MOST_THINGS:
        raise InputError(f"found {things.max()} objects, expected at most {MOST_THINGS}")
    arrays = gaussians.to_arrays()
    order = morton_order(arrays["means"])
    low, step, codes = _in_blocks(arrays["means"][order])
    scales = arrays["scales"][order]
    logs = np.log(np.maximum(scales, max(SMALLEST * float(scales.max()), 1e-30)))
    first, span = float(logs.min()), float(logs.max() - logs.min())
    scale_codes = np.rint((logs - first) / max(span, 1e-12) * 1023).astype(np.uint32)
    rgb = (arrays["sh"][order, 0] * np.float32(SH_C0) + np.float32(0.5)).clip(0, 1)
    red, green, blue = np.rint(rgb * 255).astype(np.uint8).T
    mine = things[order].astype(np.uint32)
    guessed = arrays.get("guessed", np.zeros(len(order), bool))[order]
    columns = {
        "low": low.astype("<f4"),
        "step": step.astype("<f4"),
        "rotation": pack_quats(arrays["quats"][order][:, [1, 2, 3, 0]]).astype("<u4"),
        "scales": (scale_codes << np.array([0, 10, 20], np.uint32)).sum(1).astype("<u4"),
        "high_byte": (codes >> 8).astype(np.uint8).T,
        "low_byte": (codes & 255).astype(np.uint8).T,
        "red": red,
        "green": green,
        "blue": blue,
        "opacity": np.rint(arrays["opacities"][order] * 255).astype(np.uint8),
        "thing": np.stack([mine & 255, mine >> 8]).astype(np.uint8),
        "guessed": guessed.astype(np.uint8),
    }
    layout: Layout = {}
    parts, offset = [], 0
    for name, column in columns.items():
        layout[name] = (f"{column.dtype.kind}{column.dtype.itemsize}", offset, column.size)
        parts.append(column.tobytes())
        offset += column.nbytes
    data = gzip.compress(b"".join(parts), level, mtime=0)
    return Packed(data, layout, (first, span / 1023))


def morton_order(means: np.ndarray) -> np.ndarray:
    """Places of means [N, 3] along a curve that fills space, so that neighbours are near."""
    low, high = np.percentile(means, [1, 99], axis=0)
    share = ((means - low) / np.maximum(high - low, 1e-12)).clip(0, 1)
    cell = (share * 1023).astype(np.uint64)
    key = np.zeros(len(means), np.uint64)
    for bit in range(10):
        for axis in range(3):
            digit = (cell[:, axis] >> np.uint64(bit)) & np.uint64(1)
            key |= digit << np.uint64(3 * bit + axis)
    return np.argsort(key, kind="stable")


def _in_blocks(means: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corner [B, 3] and step [B, 3] of each block's box, and codes of 16 bits [N, 3]."""
    starts = np.arange(0, len(means), BLOCK)
    low = np.minimum.reduceat(means, starts)
    step = (np.maximum.reduceat(means, starts) - low) / np.float32(65535)
    block = np.arange(len(means)) // BLOCK
    codes = np.rint((means - low[block]) / np.maximum(step[block], 1e-30)).clip(0, 65535)
    return low, step, codes.astype(np.uint32)
