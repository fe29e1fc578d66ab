"""Garbage collection and verification of a store: ``slgaussian store gc`` and ``verify``.

Files are processed folder by folder. Memory grows only with the number of artifacts that records
refer to, by some hundred bytes each.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain

from slgaussian.errors import SpecError
from slgaussian.storage.records import FOLDER, Records
from slgaussian.storage.specs import spec_names
from slgaussian.storage.store import ArtifactStore, File, ref_of

CONCURRENT_READS = 4
"""Number of artifacts of a remote store read concurrently; each may take 100 MB of memory."""

_UNFINISHED = re.compile(r".*/\.[^/]+\.tmp|\.probe-[0-9a-f]{32}")
_OURS = {"", FOLDER, "digests", *spec_names()}


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
            referred.update(map(_name, record.named))
    for files in store.walk():
        gone = []
        for file in files:
            old = file.written < bound
            if (
                _UNFINISHED.fullmatch(file.uri)
                and file.uri.rpartition("/")[0].split("/")[0] in _OURS
            ):
                garbage.unfinished += old
                gone += [file] * old
            elif ref_of(file.uri) is None:
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


@dataclass
class Damage:
    """Result of the verification of a store.

    Attributes:
        sound: Number of undamaged artifacts.
        damaged: Messages about damaged artifacts and records, by path.
        missing: Number of missing artifacts that a record refers to; runs recompute them on demand.
    """

    sound: int = 0
    damaged: dict[str, str] = field(default_factory=dict)
    missing: int = 0


def verify(store: ArtifactStore, remove: bool = False) -> Damage:
    """Read all artifacts and records of a store and check them by their specs and digests.

    Artifacts of earlier versions of their specs count as damaged; :func:`collect` removes them too.
    With ``remove``, damaged files are deleted, so that the next run recomputes them. InputError if
    the store cannot be read, or with ``remove`` not written.
    """
    damage = Damage()
    present: set[bytes] = set()

    def problem_of(file: File) -> str | None:
        ref = ref_of(file.uri)
        if ref is None:
            return None
        try:
            store.fetch(file.uri, "an artifact", lambda data: store.decode(ref, data))
        except SpecError as error:
            return str(error)
        return ""

    for files in store.walk():
        for file, problem in zip(
            files, store.map(problem_of, files, CONCURRENT_READS), strict=True
        ):
            if problem:
                damage.damaged[file.uri] = problem
            elif problem is not None:
                damage.sound += 1
                present.add(_name(file.uri))
    for record in chain.from_iterable(Records(store).all()):
        if record.ref is None:
            place = f"{store.root}/{record.file.uri}"
            damage.damaged[record.file.uri] = f"{place}: found no record, expected a ref as JSON"
        for uri in record.named:
            damage.missing += uri not in damage.damaged and _name(uri) not in present
    if remove:
        store.remove(damage.damaged)
    return damage


def _name(uri: str) -> bytes:
    """Return the digest in a path, as bytes to save memory: there may be millions."""
    return uri.rpartition("/")[2].partition(".")[0].encode()
