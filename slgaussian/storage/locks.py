"""One at a time: a lock that the kernel takes back from a process however that ends."""

from __future__ import annotations

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from slgaussian.errors import InputError


class BusyError(InputError):
    """Another process holds the lock."""


@contextmanager
def held(file: Path, what: str, wait: bool = False) -> Iterator[None]:
    """Hold a lock for the time of the block; it is given back by ``kill -9`` too.

    Parameters
    ----------
    file : Path
        The lock, made if it is not there, in a folder that is made likewise. It says who holds it,
        for people; it stays behind, and means nothing then.
    what : str
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
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror})") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError as error:
            raise BusyError(f"{what}: {file.parent} is in use by {_holder(descriptor)}") from error
        except OSError as error:
            raise InputError(
                f"{file}: cannot be locked ({error.strerror}); choose a folder on a disk that has "
                "locks"
            ) from error
        about = {
            "process": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(about).encode(), 0)
        yield
    finally:
        os.close(descriptor)


def _holder(descriptor: int) -> str:
    try:
        about = json.loads(os.pread(descriptor, 1000, 0))
        return f"process {about['process']} on {about['host']} since {about['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
