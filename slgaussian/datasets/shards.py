"""Samples in the shards of a training set: tar files as WebDataset reads them.

The members of one sample stand beside each other and share a key: ``KEY.context_0.jpg``,
``KEY.labels.npz`` and so on. The bytes depend on nothing but keys and contents, so a shard is its
samples, one after the other, and :data:`END`.
"""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
from collections.abc import Mapping

END = bytes(2 * tarfile.BLOCKSIZE)
"""The end of a tar file."""

LONGEST = 48
"""Letters of a key that are a clip's own."""


def key_of(clip: str) -> str:
    """Return the name of a clip's members: letters, digits, ``_`` and ``-``.

    A dot would end the key, and a slash make a folder. A name that has such letters, or is too
    long, gets eight digits of its SHA-256, so that no two clips have one key.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", clip)[:LONGEST]
    if plain == clip:
        return clip
    return f"{plain}-{hashlib.sha256(clip.encode()).hexdigest()[:8]}"


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """Pack one sample as a part of a tar file; members by what their names end in."""
    parts = []
    for ending, data in members.items():
        info = tarfile.TarInfo(f"{key}.{ending}")
        info.size = len(data)
        # Its time is 0 and its owner nobody, whoever writes it whenever.
        parts += [info.tobuf(tarfile.PAX_FORMAT), data, bytes(-len(data) % tarfile.BLOCKSIZE)]
    return b"".join(parts)


def unpack(data: bytes) -> dict[str, bytes]:
    """Inverse of :func:`pack`; ValueError if it is no part of a tar file."""
    members = {}
    try:
        with tarfile.open(fileobj=io.BytesIO(data + END), mode="r:") as archive:
            for info in archive:
                file = archive.extractfile(info)
                if file is not None:
                    members[info.name.partition(".")[2]] = file.read()
    except tarfile.TarError as error:
        raise ValueError(str(error)) from None
    return members
