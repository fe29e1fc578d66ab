"""What a file, folder or model from outside is known by: its content, and not its place."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

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


PartSettings = Mapping[str, Mapping[str, Any]]
"""Settings of parts by the part's name, as in ``{"mvsplat": {"checkpoint": "re10k.ckpt"}}``."""

DIGESTS = {
    "checkpoint": file_digest,
    "model": lambda place: _of("parts.pretrained").model_digest(place),
    "tokenizer": lambda place: _of("parts.pretrained").tokenizer_digest(place),
    "synonyms": lambda place: _of("parts.pretrained").model_digest(place),
    "table": file_digest,
    "folder": lambda place: _of("masks.precomputed").folder_digest(place),
    "weights": lambda place: file_digest(_of("semantic.branch").find_weights(place)),
}
"""What stands for a setting of this name, a place, in artifacts and cache keys: its content."""


def _of(module: str) -> Any:
    return import_module(f"slgaussian.{module}")


def described(settings: PartSettings) -> dict[str, dict[str, Any]]:
    """Settings of parts as artifacts and cache keys hold them: files by content, not by place.

    That is, of a setting called ``checkpoint`` the SHA-256 of the file, hexadecimal; see
    :data:`DIGESTS`.

    Raises
    ------
    InputError
        If a value cannot be written down.
    """
    found = {
        part: {
            name: DIGESTS[name](value) if name in DIGESTS and value is not None else value
            for name, value in own.items()
        }
        for part, own in settings.items()
    }
    try:
        json.dumps(found)
    except TypeError as error:
        raise InputError(f"settings: {error}; give plain numbers and text") from None
    return found


def places(own: Mapping[str, Any]) -> dict[str, str]:
    """Where the files among a part's settings are: paths from the root, names on the hub as such.

    Of settings that :func:`described` made, the digests.
    """
    given = {name: Path(value) for name, value in own.items() if name in DIGESTS and value}
    return {name: str(p.resolve() if p.exists() else p) for name, p in given.items()}


def placed(own: Mapping[str, Any], where: Mapping[str, str], otherwise: str) -> dict[str, Any]:
    """The settings that :func:`described` made of a part, with its files by place again.

    Parameters
    ----------
    own : mapping
        With a digest for each file.
    where : {setting: place}
        A file of which no digest is known is taken as it is.
    otherwise : str
        What is said of a file with another content.

    Raises
    ------
    InputError
        If a file has another content, or cannot be found.
    """
    for name, place in where.items():
        known = own.get(name)
        try:
            same = known is None or DIGESTS[name](place) == known
        except OSError as error:
            raise InputError(f"{name} {place}: cannot be read ({error.strerror})") from error
        if not same:
            raise InputError(f"{name} {place}: {otherwise}")
    return {**own, **where}
