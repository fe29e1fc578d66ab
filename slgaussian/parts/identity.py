"""What a file, folder or model from outside is known by: its content, and not its place."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from slgaussian.errors import InputError
from slgaussian.io import file_sha256
from slgaussian.parts.settings import Content

CHANGED = "was changed after the run had begun; start the run again"
"""What is said of a file with another content than a run began with."""

SETTLED = 2.0
"""Seconds after which a file's times tell that it was changed: clocks of file systems tick this
slowly, and a file may be written twice within a tick."""


@dataclass(frozen=True)
class KnownFile:
    """A file, folder or model from outside.

    Attributes
    ----------
    place : str
        Where it is: a path from the root, or a name as on the Hugging Face hub.
    digest : str or None
        What its content is known by; None if any content will do.
    """

    place: str
    digest: str | None

    @staticmethod
    def at(place: str | Path, content: Content) -> KnownFile:
        """What is at a place now; raises as ``content``."""
        found = Path(place)
        known = str(found.resolve() if found.exists() else found)
        return KnownFile(known, content(known))

    def checked(self, name: str, content: Content, otherwise: str = CHANGED) -> str:
        """The place, at which there is still what is known.

        Raises
        ------
        InputError
            If it cannot be read, or is another one: then ``otherwise`` is said of it. The sentence
            begins with ``name`` and the place.
        """
        try:
            same = self.digest is None or content(self.place) == self.digest
        except OSError as error:
            raise InputError(f"{name} {self.place}: cannot be read ({error.strerror})") from error
        if not same:
            raise InputError(f"{name} {self.place}: {otherwise}")
        return self.place


def file_digest(place: str | Path) -> str:
    """SHA-256 of a file, hexadecimal; OSError if it cannot be read.

    A file of gigabytes, or one that many scenes share, is read once for each :func:`file_stamp`.
    """
    file = Path(place).resolve()
    stamp = file_stamp(file)
    return file_sha256(file) if stamp is None else _digest_of(file, stamp)


def file_stamp(file: str | Path) -> tuple[int, ...] | None:
    """Numbers that change whenever the content of a local file does; OSError if it is not there.

    The time at which the inode changed is among them: unlike that of the content, no program that
    copies or unpacks files sets it back. None within :data:`SETTLED` seconds of a change.
    """
    state = os.stat(file)
    if time.time() - state.st_mtime < SETTLED:
        return None
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns


@lru_cache(maxsize=1024)
def _digest_of(file: Path, stamp: tuple[int, ...]) -> str:
    return file_sha256(file)
