"""JSON that anybody wrote: whatever cannot be used is a ValueError, and nothing else."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from typing import Any

LONGEST = 18
"""Digits of the longest whole number that stays one; longer ones do not fit into 64 bits."""

_HALF = re.compile(r"\\u[dD][89a-fA-F]")


def parse(text: str | bytes) -> Any:
    """Parse a JSON text, with or without a byte-order mark.

    Whole numbers of more than :data:`LONGEST` digits become floats. NaN and Infinity pass, as other
    programs write them where they do not matter: who uses a number names it.

    Raises
    ------
    ValueError
        If it is not valid JSON, not UTF-8, nested too deeply, has a number that no 64-bit float
        holds, or text with half of a pair of code units, which can be written to no file.
    """
    if isinstance(text, bytes):
        text = text.decode("utf-8-sig")
    odd: list[str] = []

    def real(digits: str) -> float:
        number = float(digits)
        if not math.isfinite(number):
            odd.append(digits)
        return number

    def whole_number(digits: str) -> float:
        return int(digits) if len(digits) <= LONGEST else real(digits)

    try:
        content = json.loads(text, parse_int=whole_number, parse_float=real)
        # None where a later value of the same key has taken its place.
        if odd and (bad := next(_not_finite(content), None)):
            raise ValueError(f"{bad[0] or 'it'} is {bad[1]}, expected a number that 64 bits hold")
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if _HALF.search(text):
        try:
            json.dumps(content, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("it has text with half of a surrogate pair") from None
    return content


def _not_finite(content: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """The numbers that are NaN or infinite, with their places, such as ``frames[0].cx``."""
    if isinstance(content, float) and not math.isfinite(content):
        yield place, content
    elif isinstance(content, dict):
        for key, value in content.items():
            yield from _not_finite(value, f"{place}.{key}" if place else key)
    elif isinstance(content, list):
        for number, value in enumerate(content):
            yield from _not_finite(value, f"{place}[{number}]")
