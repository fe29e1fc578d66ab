"""What a file, folder or model from outside is known by: its content, and not its place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from slgaussian.errors import InputError
from slgaussian.parts.settings import Content

CHANGED = "was changed after the run had begun; start the run again"
"""What is said of a file with another content than a run began with."""


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
    """SHA-256 of a file, hexadecimal; OSError if it cannot be read."""
    file = Path(place).resolve()
    state = file.stat()
    return _digest_of(file, state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=64)
def _digest_of(file: Path, size: int, changed: int) -> str:
    """SHA-256 of a file of gigabytes, taken once for each size and time of change."""
    from slgaussian.storage.store import sha256_of

    return sha256_of(file)
