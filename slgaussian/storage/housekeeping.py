"""Clean and check a store: ``slgaussian store gc`` and ``verify``.

Files are gone through folder by folder, so memory does not go with their number, except for some
hundred bytes for each artifact that a record names.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import pyarrow as pa

from slgaussian.errors import InputError, SpecError
from slgaussian.storage.records import FOLDER, Record, Records
from slgaussian.storage.specs import spec_names
from slgaussian.storage.store import ArtifactStore, File, ref_of
from slgaussian.storage.tables import read_table

SIDE_BY_SIDE = 4
"""Artifacts of a store elsewhere that are read at the same time: each may take 100 MB of memory."""

_UNFINISHED = re.compile(r".*/\.[^/]+\.tmp|\.probe-[0-9a-f]{32}")
_OURS = {"", FOLDER, "digests", *spec_names()}


@dataclass
class Garbage:
    """Files that nothing refers to, and that were written before some age.

    Attributes
    ----------
    artifacts, records, unfinished : int
        Artifacts that no record names; records of other versions of a stage, and unreadable ones;
        files that a killed program left.
    bytes : int
        Of all the files among them.
    kept, young : int
        Artifacts that are referred to, and those that are not but are too young.
    """

    artifacts: int = 0
    records: int = 0
    unfinished: int = 0
    bytes: int = 0
    kept: int = 0
    young: int = 0


def collect(
    store: ArtifactStore,
    age: float,
    versions: Mapping[str, int] | None = None,
    keep: Collection[Path] = (),
    delete: bool = False,
) -> Garbage:
    """Find, and with ``delete`` remove, what nothing in a store refers to.

    What a record under ``keys/`` names stays, with its parts. A file that was written less than
    ``age`` seconds ago, by the clock of the store, stays too: a run writes what it makes before
    the record that names it, and always anew, whether it is there or not. Should a run still miss
    something, it makes it again.

    Parameters
    ----------
    store : ArtifactStore
    age : float
        Seconds.
    versions : dict, optional
        Versions of the stages as they are now. Records of others of these stages, which this
        installation never reads, are then garbage too, with what only they name.
    keep : paths
        Parquet tables with a column ``uri``, such as ``lessons.parquet``: what they name stays.

    Raises
    ------
    InputError
        If the store cannot be read or written, or a table of ``keep`` is none.
    """
    bound = store.clock() - age
    garbage = Garbage()
    referred = set[bytes]()
    for table in keep:
        try:
            referred.update(map(_name, read_table(table, ["uri"])["uri"].to_pylist()))
        except (OSError, ValueError, pa.ArrowException, KeyError) as error:
            raise InputError(
                f"{table}: cannot be read ({error}); expected a Parquet table with a column uri"
            ) from error
    for record in chain.from_iterable(Records(store).all()):
        if record.file.written < bound and not _is_current(record, versions):
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
                continue  # nobody knows whose it is
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
    """Findings of a look at all artifacts.

    Attributes
    ----------
    sound : int
        Artifacts that are what they should be.
    damaged : dict
        Sentence by path, of artifacts and records that are not.
    missing : int
        Artifacts that a record names and that are not there: they are made when asked for.
    superseded : int
        Artifacts that are not what their specs say now and that only stages of other versions made:
        nothing reads them any more.
    """

    sound: int = 0
    damaged: dict[str, str] = field(default_factory=dict)
    missing: int = 0
    superseded: int = 0


def verify(
    store: ArtifactStore, remove: bool = False, versions: Mapping[str, int] | None = None
) -> Damage:
    """Read every artifact and record of a store, and compare them with their specs and digests.

    With ``remove`` those that are damaged are deleted, so that the next run that asks for one makes
    it again. ``versions`` are those of the stages as they are now, as for :func:`collect`.
    InputError if the store cannot be read, or not written with ``remove``.
    """
    damage = Damage()
    present: set[bytes] = set()
    in_use: dict[str, bool] = {}

    def problem_of(file: File) -> str | None:
        ref = ref_of(file.uri)
        if ref is None:
            return None
        try:
            store.fetch(file.uri, "an artifact", lambda data: store.understood(ref, data))
        except SpecError as error:
            return str(error)
        return ""

    for files in store.walk():
        for file, problem in zip(
            files, store.at_once(problem_of, files, SIDE_BY_SIDE), strict=True
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
            if uri in damage.damaged:
                in_use[uri] = in_use.get(uri, False) or _is_current(record, versions)
            else:
                damage.missing += _name(uri) not in present
    for uri, used in in_use.items():
        if not used:
            del damage.damaged[uri]
            damage.superseded += 1
    if remove:
        store.remove(damage.damaged)
    return damage


def _is_current(record: Record, versions: Mapping[str, int] | None) -> bool:
    """Tell whether it can be read, and is of the version of its stage, where that is known."""
    version = (versions or {}).get(record.stage, record.version)
    return record.ref is not None and record.version == version


def _name(uri: str) -> bytes:
    """Return what tells artifacts apart, in few bytes: there may be millions."""
    return uri.rpartition("/")[2].partition(".")[0].encode()
