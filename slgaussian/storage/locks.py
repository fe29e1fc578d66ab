"""Inter-process file locks, which the kernel releases however their process ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from slgaussian.errors import InputError


class BusyError(InputError):
    """Another process holds the lock."""


@contextmanager
def hold_lock(file: Path, action: str, wait: bool = False) -> Iterator[None]:
    """Hold a lock within the block; ``kill -9`` releases it too.

    Args:
        file: Lock file, created with its folder if missing. It is not removed; an unlocked file has
            no effect.
        action: Beginning of the error message, such as the command.
        wait: Wait until the lock is free.

    Raises:
        BusyError: If another process holds the lock and ``wait`` is false.
        InputError: If the file cannot be written.
    """
    lock = FileLock(file, timeout=-1 if wait else 0)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise BusyError(f"{action}: {file.parent} is in use by another process") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror})") from error
    try:
        yield
    finally:
        lock.release()
