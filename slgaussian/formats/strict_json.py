"""Parsing of untrusted JSON: every problem raises ValueError."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from typing import Any

LONGEST = 18
"""Largest number of digits of an integer that fits into 64 bits."""

_HALF = re.compile(r"\\u[dD][89a-fA-F]")


def parse(text: str | bytes) -> Any:
    """Parse a JSON text, with or without a byte-order mark.

    Integers of more than :data:`LONGEST` digits become floats. NaN and Infinity are accepted,
    because other programs write them in unused fields; readers check the numbers that they use.

    Raises:
        ValueError: If it is not valid JSON, not UTF-8, nested too deeply, has a number beyond the
            range of 64-bit floats, or text with half of a surrogate pair, which cannot be encoded.
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
        # None if a later value of the same key replaced the number.
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
    """Yield the path, such as ``frames[0].cx``, and value of NaN and infinite numbers."""
    if isinstance(content, float) and not math.isfinite(content):
        yield place, content
    elif isinstance(content, dict):
        for key, value in content.items():
            yield from _not_finite(value, f"{place}.{key}" if place else key)
    elif isinstance(content, list):
        for number, value in enumerate(content):
            yield from _not_finite(value, f"{place}[{number}]")
