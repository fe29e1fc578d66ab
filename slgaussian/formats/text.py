"""Reading of UTF-8 text files, with or without a byte-order mark."""

from __future__ import annotations

from pathlib import Path


def read_lines(file: str | Path) -> list[str]:
    """Read the lines of a file, separated by LF or CR LF.

    Other characters at which :meth:`str.splitlines` splits (U+2028, U+0085, form feed) may be part
    of names.

    Raises:
        OSError, UnicodeDecodeError: If it cannot be read, or is not valid UTF-8.
    """
    text = Path(file).read_bytes().decode("utf-8-sig")
    return [line.removesuffix("\r") for line in text.split("\n")]
