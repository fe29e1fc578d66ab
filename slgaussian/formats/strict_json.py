"""JSON that anybody wrote: whatever cannot be used is a ValueError, and nothing else."""

from __future__ import annotations

import json
import re
from typing import Any

LONGEST = 18
"""Digits of the longest whole number that stays one; longer ones do not fit into 64 bits."""

_HALF = re.compile(r"\\u[dD][89a-fA-F]")


def parse(text: str | bytes) -> Any:
    """What a JSON text holds; whole numbers of more than :data:`LONGEST` digits as floats.

    Raises
    ------
    ValueError
        If it is not valid JSON, not UTF-8, nested too deeply, or has text with half of a pair of
        code units, which can be written to no file.
    """
    if isinstance(text, bytes):
        text = text.decode("utf-8")
    try:
        content = json.loads(text, parse_int=_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if _HALF.search(text):
        try:
            json.dumps(content, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("it has text with half of a surrogate pair") from None
    return content


def _number(digits: str) -> float:
    return int(digits) if len(digits) <= LONGEST else float(digits)
