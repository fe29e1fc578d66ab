"""One at a time: a lock that the kernel takes back from a process however that ends."""

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
    """Hold a lock for the time of the block; ``kill -9`` releases it too.

    Parameters
    ----------
    file : Path
        The lock, made if it is not there, in a folder that is made likewise. It stays behind, and
        means nothing then.
    action : str
        What is to be done, to begin the message with.
    wait : bool
        Wait for whoever holds it.

    Raises
    ------
    BusyError
        If another process holds it, and ``wait`` is not set.
    InputError
        If the file cannot be written.
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
