"""Garbage collection of a store: ``slgaussian store gc``.

Files are processed folder by folder. Memory grows only with the number of artifacts that records
refer to, by some hundred bytes each.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

from slgaussian.storage.records import FOLDER, Records
from slgaussian.storage.specs import spec_names
from slgaussian.storage.store import ArtifactStore, parse_uri

_UNFINISHED = re.compile(r".*/\.[^/]+\.tmp|\.probe-[0-9a-f]{32}")
_FOLDERS = {"", FOLDER, "digests", *spec_names()}


@dataclass
class Garbage:
    """Numbers of unreferenced files that are older than some age.

    Attributes:
        artifacts, records, unfinished: Artifacts that no record refers to; unreadable records and
            those of other stage versions; temporary files of killed programs.
        bytes: Total size of these files.
        kept, young: Referenced artifacts, and unreferenced ones that are too recent to be removed.
    """

    artifacts: int = 0
    records: int = 0
    unfinished: int = 0
    bytes: int = 0
    kept: int = 0
    young: int = 0


def collect(
    store: ArtifactStore, age: float, versions: Mapping[str, int], delete: bool = False
) -> Garbage:
    """Find unreferenced files of a store, and with ``delete`` remove them.

    Artifacts that a record under ``keys/`` refers to, and their parts, stay. Files written less
    than ``age`` seconds ago by the clock of the store stay too, because a run writes an artifact
    before its record, and rewrites an artifact that exists. A run recomputes an artifact that was
    removed all the same.

    Args:
        age: Seconds.
        versions: dict. Current versions of the stages. Records of other versions of these stages,
            which this installation never reads, and artifacts that only they refer to are garbage.

    Raises:
        InputError: If the store cannot be read or written.
    """
    bound = store.clock() - age
    garbage = Garbage()
    referred = set[bytes]()
    for record in chain.from_iterable(Records(store).all()):
        is_current = record.version == versions.get(record.stage, record.version)
        if record.file.written < bound and (record.ref is None or not is_current):
            garbage.records += 1
            garbage.bytes += record.file.size
            if delete:
                store.remove([record.file.uri])
        else:
            referred.update(map(_name, record.uris))
    for files in store.walk():
        gone = []
        for file in files:
            old = file.written < bound
            folder = file.uri.rpartition("/")[0].split("/")[0]
            if _UNFINISHED.fullmatch(file.uri) and folder in _FOLDERS:
                garbage.unfinished += old
                gone += [file] * old
            elif parse_uri(file.uri) is None:
                continue  # not a file of the store
            elif _name(file.uri) in referred:
                garbage.kept += 1
            else:
                garbage.artifacts += old
                garbage.young += not old
                gone += [file] * old
        garbage.bytes += sum(file.size for file in gone)
        if delete:
            store.remove([file.uri for file in gone])
    return garbage


def _name(uri: str) -> bytes:
    """Return the digest in a path, as bytes to save memory: there may be millions."""
    return uri.rpartition("/")[2].partition(".")[0].encode()
