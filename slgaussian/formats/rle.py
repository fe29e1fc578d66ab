"""Masks as run lengths, as COCO writes them: https://github.com/cocodataset/cocoapi, maskApi.c.

A mask is read column by column. ``counts`` are the lengths of its runs, of pixels outside and
inside by turns; the first is of pixels outside, and 0 where the mask begins inside. They are a list
of numbers, or the text of them: from the fourth on each as what it is more than the second before,
in groups of five bits, the lowest first, a character each from ``0`` on. The sixth bit says that
more follow; the fifth of the last group is the sign.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_FIRST = ord("0")
_MOST_GROUPS = 8
"""Of a number: 40 bits, more than any image has pixels."""


def decode(counts: str | Sequence[int], height: int, width: int) -> np.ndarray:
    """The mask bool [height, width] of counts, as text or as a list.

    Raises
    ------
    ValueError
        If they are neither, or do not make up that many pixels; the text says what is wrong.
    """
    lengths = _lengths(counts) if isinstance(counts, str) else counts
    if not isinstance(lengths, Sequence) or not all(type(n) is int and n >= 0 for n in lengths):
        raise ValueError("its counts are no run lengths: expected numbers from 0 on, or their text")
    total = sum(lengths)
    if total != height * width:
        raise ValueError(f"its counts make up {total} pixels, and its size {height * width}")
    inside = np.arange(len(lengths)) % 2 == 1
    return np.repeat(inside, np.array(lengths, np.int64)).reshape((height, width), order="F")


def _lengths(text: str) -> list[int]:
    """The numbers of a text; ValueError if it breaks off or holds another character."""
    lengths: list[int] = []
    value = groups = 0
    for character in text:
        bits = ord(character) - _FIRST
        if not 0 <= bits < 64:
            raise ValueError(f"its counts hold {character!r}, which is no character of them")
        value |= (bits & 31) << 5 * groups
        groups += 1
        if bits & 32:
            if groups == _MOST_GROUPS:
                raise ValueError("its counts hold a number that no image has pixels for")
            continue
        if bits & 16:
            value -= 1 << 5 * groups
        lengths.append(value + lengths[-2] if len(lengths) > 2 else value)
        value = groups = 0
    if groups:
        raise ValueError("its counts break off within a number")
    return lengths
