"""Samples in the shards of a training set: tar files in the WebDataset format.

The members of one sample are adjacent and share a key: ``KEY.context_0.jpg``, ``KEY.labels.npz``
and so on. The bytes depend only on keys and contents, so a shard is the concatenation of its
samples and :data:`END_OF_ARCHIVE`.
"""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
from collections.abc import Mapping

END_OF_ARCHIVE = bytes(2 * tarfile.BLOCKSIZE)  # the end of a tar file
MAX_NAME_LENGTH = 48  # largest number of characters of the clip's name in a key


def key_of(clip: str) -> str:
    """Return the key of a clip: letters, digits, ``_`` and ``-``.

    A dot would end the key, and a slash create a folder. A name with other characters, or one that
    is too long, is extended by eight digits of its SHA-256, so that keys are unique.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", clip)[:MAX_NAME_LENGTH]
    if plain == clip:
        return clip
    return f"{plain}-{hashlib.sha256(clip.encode()).hexdigest()[:8]}"


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """Pack one sample as a part of a tar file; members by the suffix of their names."""
    parts = []
    for ending, data in members.items():
        info = tarfile.TarInfo(f"{key}.{ending}")
        info.size = len(data)
        # TarInfo defaults to time 0 and no owner, so the bytes are reproducible.
        parts += [info.tobuf(tarfile.PAX_FORMAT), data, bytes(-len(data) % tarfile.BLOCKSIZE)]
    return b"".join(parts)


def unpack(data: bytes) -> dict[str, bytes]:
    """Invert :func:`pack`; ValueError if ``data`` is not a part of a tar file."""
    members = {}
    try:
        with tarfile.open(fileobj=io.BytesIO(data + END_OF_ARCHIVE), mode="r:") as archive:
            for info in archive:
                file = archive.extractfile(info)
                if file is not None:
                    members[info.name.partition(".")[2]] = file.read()
    except tarfile.TarError as error:
        raise ValueError(str(error)) from None
    return members
