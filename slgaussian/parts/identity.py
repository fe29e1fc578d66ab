"""Settings of the parts of the method. Files among them are given by place and known by content."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slgaussian.errors import InputError
from slgaussian.masks.precomputed import folder_digest
from slgaussian.parts.pretrained import model_digest, tokenizer_digest
from slgaussian.semantic.branch import find_weights
from slgaussian.storage.store import sha256_of

PartSettings = Mapping[str, Mapping[str, Any]]
"""Settings of parts by the part's name, as in ``{"mvsplat": {"checkpoint": "re10k.ckpt"}}``."""

DIGESTS = {
    "checkpoint": sha256_of,
    "model": model_digest,
    "tokenizer": tokenizer_digest,
    "synonyms": model_digest,
    "table": sha256_of,
    "folder": folder_digest,
    "weights": lambda place: sha256_of(find_weights(place)),
}
"""What stands for a setting of this name, a place, in artifacts and cache keys: its content."""


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
