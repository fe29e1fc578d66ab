"""Text files that anybody wrote: UTF-8, with or without a byte-order mark."""

from __future__ import annotations

from pathlib import Path


def read_lines(file: str | Path) -> list[str]:
    """Read the lines of a file, each as it stands between line feeds, or CR and line feed.

    Other characters at which :meth:`str.splitlines` breaks (U+2028, U+0085, form feed) are part of
    names.

    Raises
    ------
    OSError, UnicodeDecodeError
        If it cannot be read, or is not UTF-8.
    """
    text = Path(file).read_bytes().decode("utf-8-sig")
    return [line.removesuffix("\r") for line in text.split("\n")]
