"""Run-length encoded masks of COCO: https://github.com/cocodataset/cocoapi, maskApi.c.

A mask is traversed column by column. ``counts`` are the lengths of alternating runs of pixels
outside and inside; the first run is outside, with length 0 if the mask begins inside. They are a
list of numbers, or a string in which each count from the fourth on is replaced by its difference to
the count two places before. Numbers are split into groups of five bits, lowest first, one character
per group starting at ``0``. Bit 6 marks a continuation; bit 5 of the last group is the sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_FIRST = ord("0")
_MAX_GROUPS = 8
"""Largest number of groups of one count: 40 bits, enough for any image."""


class RunLengths(NamedTuple):
    """A mask: height and width in pixels, and counts as a string."""

    height: int
    width: int
    counts: str

    def decode(self) -> np.ndarray:
        """Decode the mask, bool [height, width]; ValueError if the counts are damaged."""
        return decode(self.counts, self.height, self.width)


def encode(mask: np.ndarray) -> RunLengths:
    """Encode a mask, bool [H, W], with the counts as a string."""
    flat = np.asarray(mask, bool).ravel(order="F")
    return _compress(np.flatnonzero(np.diff(flat, prepend=False)), *mask.shape)


def encode_ids(ids: np.ndarray) -> dict[int, RunLengths]:
    """Encode the mask of every id above 0 of a map int [H, W], in ascending order."""
    flat = ids.ravel(order="F")
    starts = np.flatnonzero(np.diff(flat, prepend=0))
    runs, owners = np.stack([starts, np.append(starts, flat.size)[1:]], 1), flat[starts]
    used = np.unique(owners[owners > 0])
    return {int(id_): _compress(runs[owners == id_].ravel(), *ids.shape) for id_ in used}


def _compress(changes: np.ndarray, height: int, width: int) -> RunLengths:
    """Encode a mask by the places, in the order of columns, where its runs begin and have ended."""
    total = height * width
    values = np.diff(changes[changes < total], prepend=0, append=total)
    values[3:] -= values[1:-2]
    groups, written, unfinished = [], [], np.ones(len(values), bool)
    while unfinished.any():
        low, values = values & 31, values >> 5
        written.append(unfinished)
        unfinished = unfinished & (values != np.where(low & 16, -1, 0))
        groups.append((_FIRST + low + 32 * unfinished).astype(np.uint8))
    counts = np.stack(groups, 1)[np.stack(written, 1)].tobytes().decode("ascii")
    return RunLengths(height, width, counts)


def decode(counts: str | Sequence[int], height: int, width: int) -> np.ndarray:
    """Decode the mask, bool [height, width], of counts as a string or a list.

    Raises:
        ValueError: If they are neither, or do not add up to that many pixels; the message states
            the problem.
    """
    lengths = _lengths(counts) if isinstance(counts, str) else counts
    if not isinstance(lengths, Sequence) or not all(type(n) is int and n >= 0 for n in lengths):
        raise ValueError("its counts are not run lengths: expected numbers from 0 on, or a string")
    total = sum(lengths)
    if total != height * width:
        raise ValueError(f"its counts add up to {total} pixels, expected {height * width}")
    inside = np.arange(len(lengths)) % 2 == 1
    return np.repeat(inside, np.array(lengths, np.int64)).reshape((height, width), order="F")


def _lengths(text: str) -> list[int]:
    """Decode the counts of a string; ValueError if it is truncated or has an invalid character."""
    lengths: list[int] = []
    value = groups = 0
    for character in text:
        bits = ord(character) - _FIRST
        if not 0 <= bits < 64:
            raise ValueError(f"its counts have the invalid character {character!r}")
        value |= (bits & 31) << 5 * groups
        groups += 1
        if bits & 32:
            if groups == _MAX_GROUPS:
                raise ValueError("its counts have a number larger than any image")
            continue
        if bits & 16:
            value -= 1 << 5 * groups
        lengths.append(value + lengths[-2] if len(lengths) > 2 else value)
        value = groups = 0
    if groups:
        raise ValueError("its counts end within a number")
    return lengths
