"""Rotations in 32 bits: the smallest three components of a unit quaternion, as .spz has them.

The number of the largest component (2 bits), then of each other one its sign and its size in 9
bits, in units of 1 / (511 sqrt 2). Rotations come out within a quarter of a degree.
"""

from __future__ import annotations

import numpy as np

_MOST = np.float32(511 * np.sqrt(2))
"""Of a component that is not the largest, which is at most 1 / sqrt 2."""

_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def pack_quats(quats: np.ndarray) -> np.ndarray:
    """uint32 [N] of quaternions xyzw float32 [N, 4] of any length but zero."""
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
    """Unit quaternions xyzw float32 [N, 4] of uint32 [N]; inverse of :func:`pack_quats`."""
    largest = (packed >> np.uint32(30)).astype(np.int64)
    codes = packed[:, None] >> np.array([20, 10, 0], np.uint32)
    sizes = (codes & np.uint32(511)).astype(np.float32) / _MOST
    others = np.where(codes & np.uint32(512), -sizes, sizes)
    quats = np.empty((len(packed), 4), np.float32)
    rows = np.arange(len(packed))
    quats[rows[:, None], _OTHERS[largest]] = others
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - (others**2).sum(1)))
    return quats
