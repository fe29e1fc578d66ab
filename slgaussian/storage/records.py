"""Records that map cache keys to artifacts: small JSON files under ``keys/`` in a store.

They are in the store itself, so that all processes and machines that use the store share results.
They are parsed as JSON and validated, so write access to a store does not allow code execution.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from slgaussian.errors import SLGaussianError, SpecError
from slgaussian.formats import strict_json
from slgaussian.storage.specs import spec_names
from slgaussian.storage.store import ArtifactRef, ArtifactStore, File, address, is_digest

FOLDER = "keys"
_FILE = re.compile(r"keys/(?P<stage>[^/]+)/v(?P<version>\d+)/[0-9a-f]{2}/[0-9a-f]{64}\.json")


class NotStoredError(SLGaussianError):
    """A result that is required is not in the store."""


class OutdatedError(NotStoredError):
    """Only an older version of the stage has stored a result for the same arguments."""


@dataclass(frozen=True)
class Record:
    """A file under ``keys/``: stage, version, and the ref, None if it cannot be read."""

    file: File
    stage: str
    version: int
    ref: ArtifactRef | None

    @property
    def uris(self) -> list[str]:
        """Paths of the artifact and of its parts."""
        return [] if self.ref is None else self.ref.uris


class Records:
    """The records of a store, by the keys of :func:`tasks.stage.cache_key`."""

    def __init__(self, store: ArtifactStore) -> None:
        self.store = store

    def find(self, key: str) -> ArtifactRef | None:
        """Return the artifact of a cache key.

        None if the record or the artifact is missing or damaged (:meth:`ArtifactStore.check`).
        Files with the size and modification time in the record are not checked again; reading them
        compares the digest anyway. InputError if the store does not answer.
        """
        try:
            ref, stamps = self._read(_place(key))
            if stamps is None or stamps != self._stamps(ref):
                self.store.check(ref)
                if self.store.local:
                    self.keep(key, ref)
        except SpecError:
            return None
        return ref

    def require(self, key: str) -> ArtifactRef:
        """Return the artifact of a cache key as :meth:`find`; NotStoredError instead of None."""
        if (ref := self.find(key)) is not None:
            return ref
        stage, version, digest = key.split("/")
        for older in range(int(version[1:]) - 1, 0, -1):
            with suppress(SpecError):
                self._read(_place(f"{stage}/v{older}/{digest}"))
                raise OutdatedError(f"of version {older} of the stage, which is now {version[1:]}")
        raise NotStoredError("not in the store, or damaged")

    def keep(self, key: str, ref: ArtifactRef) -> None:
        """Write the record of a cache key; InputError if the store cannot be written."""
        record = {**asdict(ref), "stamp": self._stamps(ref)}
        self.store.write(_place(key), json.dumps(record, sort_keys=True).encode())

    def all(self, folder: str = FOLDER) -> Iterator[list[Record]]:
        """Yield all records below a folder, one list for each folder."""

        def read_record(file: File) -> Record:
            match = _FILE.fullmatch(file.uri)
            assert match is not None  # filtered below
            try:
                ref = self._read(file.uri)[0]
            except SpecError:
                ref = None
            return Record(file, match["stage"], int(match["version"]), ref)

        for files in self.store.walk([folder]):
            yield self.store.map(read_record, [f for f in files if _FILE.fullmatch(f.uri)])

    def _stamps(self, ref: ArtifactRef) -> list[str] | None:
        """Return the stamps of the file and of its parts; None if a stamp is missing."""
        stamps = [self.store.stamp(uri) for uri in ref.uris]
        present = [stamp for stamp in stamps if stamp is not None]
        return present if len(present) == len(stamps) else None

    def _read(self, uri: str) -> tuple[ArtifactRef, Any]:
        """Return the ref in a record and the stamps of its files; SpecError if it is invalid."""

        def parse(data: bytes) -> tuple[ArtifactRef, Any]:
            try:
                fields = strict_json.parse(data)
                stamp = fields.pop("stamp", None)
                ref = ArtifactRef(**fields)
                is_valid = ref.spec in spec_names() and ref.uri == address(ref.spec, ref.digest)
                # A forged record must not point outside the store.
                is_valid = is_valid and is_digest(ref.digest)
                for path in ref.uris:
                    is_valid = is_valid and path[:1] != "/" and ".." not in path.split("/")
            except (ValueError, TypeError, AttributeError):
                is_valid = False
            if not is_valid:
                raise SpecError(f"{self.store.root}/{uri}: found no record, expected a ref as JSON")
            return ref, stamp

        return self.store.fetch(uri, "a record", parse)[1]


def _place(key: str) -> str:
    stage, version, digest = key.split("/")
    return f"{FOLDER}/{stage}/{version}/{digest[:2]}/{digest}.json"
