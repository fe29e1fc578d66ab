"""Write a file that a user named, with one clear error where it cannot be."""

from __future__ import annotations

from pathlib import Path

from slgaussian.errors import InputError
from slgaussian.storage.store import write_atomic


def write_file(path: str | Path, data: bytes | memoryview) -> None:
    """Write ``data`` to ``path``, complete or not at all; a file that is there is replaced.

    InputError if the file cannot be written.
    """
    try:
        write_atomic(path, data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists "
            "and that you may write to"
        ) from error
