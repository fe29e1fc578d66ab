"""Parsing of untrusted JSON: every problem raises ValueError."""

from __future__ import annotations

import json
import math
import re
from typing import Any

MAX_DIGITS = 18  # largest number of digits of an integer that fits into 64 bits

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


def parse(text: str | bytes) -> Any:
    """Parse a JSON text, with or without a byte-order mark.

    Integers of more than :data:`MAX_DIGITS` digits become floats. NaN and Infinity are accepted,
    because other programs write them in unused fields; readers check the numbers that they use.

    Raises:
        ValueError: If it is not valid JSON, not UTF-8, nested too deeply, has a number beyond the
            range of 64-bit floats, or text with half of a surrogate pair, which cannot be encoded.
    """
    if isinstance(text, bytes):
        text = text.decode("utf-8-sig")

    def real(digits: str) -> float:
        number = float(digits)
        if not math.isfinite(number):
            raise ValueError(f"{digits:.40} is beyond the range of 64-bit numbers")
        return number

    def whole_number(digits: str) -> float:
        return int(digits) if len(digits) <= MAX_DIGITS else real(digits)

    try:
        content = json.loads(text, parse_int=whole_number, parse_float=real)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if _SURROGATE.search(text):
        try:
            json.dumps(content, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("it has text with half of a surrogate pair") from None
    return content
