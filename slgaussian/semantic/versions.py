"""Versions of trained weights in one folder: all are kept, at most one is in use.

``versions/000003.parquet`` is the record of version 3, a row of spec ``versions``, written once and
never changed; ``weights/<digest>.safetensors`` are its weights; ``current.json`` has the number of
the version in use. Files are written atomically and ``current.json`` last, so after a crash at any
moment the version in use exists. A lock keeps concurrent additions apart.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.io import file_sha256, write_atomic, write_file
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.locks import hold_lock
from slgaussian.storage.specs import load_spec

POINTER = "current.json"


@dataclass(frozen=True)
class Version:
    """Record of a version of the weights.

    Attributes:
        number: From 1, in order of addition.
        digest: SHA-256 of the weights file, hexadecimal.
        parent: The version that training started from; 0 for none.
        made: Time of addition, UTC, ISO 8601.
        promoted: Whether it was put to use when it was added.
        why: Reason for that, one sentence.
        facts: mapping. Settings, data and scores, as JSON data.
    """

    number: int
    digest: str
    parent: int
    made: str
    promoted: bool
    why: str
    facts: dict[str, Any]

    @property
    def split(self) -> str:
        """Digest of the held-out clips that judged it; scores of one split are comparable."""
        return str(self.facts.get("split", ""))


class Versions:
    """The versions in a folder, which is created by the first addition."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def all(self) -> list[Version]:
        """Return all versions, the oldest first.

        Raises:
            SpecError: If a record is damaged.
        """
        files = sorted((self.folder / "versions").glob("[0-9]*.parquet"))
        return [_read_record(file) for file in files if re.fullmatch(r"\d{6,}", file.stem)]

    def current(self) -> Version | None:
        """Return the version in use, None if there is none.

        Raises:
            SpecError: If ``current.json`` is damaged or names a missing version.
        """
        number = self._current_number()
        return self.version(number) if number else None

    def version(self, number: int) -> Version:
        """Return the version with a number; SpecError if its record is damaged or missing."""
        return _read_record(self._file(number))

    def find_trained_on(self, clips: Collection[str]) -> list[Version]:
        """Return the versions trained on one of the clips.

        A version that training started from has passed on what it learnt.
        """
        marks, trained = {mark_clip(clip) for clip in clips}, list[Version]()
        for version in self.all():
            learnt = marks & {*version.facts.get("learnt_clips", ())}
            if learnt or version.parent in {v.number for v in trained}:
                trained.append(version)
        return trained

    def weights(self, version: Version) -> Path:
        """Return the weights file of a version.

        Raises:
            SpecError: If it is missing or altered.
        """
        file = self.folder / "weights" / f"{version.digest}.safetensors"
        if not file.is_file() or file_sha256(file) != version.digest:
            raise SpecError(f"{file}: missing or altered; use another version, or train it again")
        return file

    def add(
        self,
        weights: bytes,
        facts: dict[str, Any],
        promote: bool,
        why: str,
        parent: Version | None = None,
    ) -> Version:
        """Add new weights, and put them to use if ``promote``.

        Args:
            facts: Settings, data and scores, as JSON data.
            why: Reason for ``promote`` being true or false, one sentence.
            parent: The version in use that training started from. If another version has been put
                to use since, they are not promoted, whatever ``promote`` says, because they were
                never compared with it.

        Raises:
            InputError: If the folder cannot be written; the version in use is then unchanged.
        """
        digest = hashlib.sha256(weights).hexdigest()
        before = 0 if parent is None else parent.number
        with self._lock():
            try:
                for name in ("weights", "versions"):
                    (self.folder / name).mkdir(parents=True, exist_ok=True)
                write_atomic(self.folder / "weights" / f"{digest}.safetensors", weights)
                written = (self.folder / "versions").glob("[0-9]*.parquet")
                version = Version(
                    max((int(file.name.partition(".")[0]) for file in written), default=0) + 1,
                    digest,
                    before,
                    datetime.now(UTC).isoformat(timespec="seconds"),
                    promote,
                    why,
                    facts,
                )
                current = self._current_number()
                if promote and current != before:
                    reason = f"{version_name(current)} came into use while it was trained; {why}"
                    version = replace(version, promoted=False, why=reason)
                file = encode_table(_table(version), load_spec("versions"))
                write_atomic(self._file(version.number), file)
            except OSError as error:
                raise InputError(
                    f"{self.folder}: cannot be written ({error.strerror or error}); the version in "
                    "use stays"
                ) from error
            if version.promoted:
                self._use(version)
        return version

    def use(self, version: Version | None) -> None:
        """Put a version to use, or none at all (None).

        Raises:
            InputError: If the folder cannot be written, or the version's weights are damaged
                (SpecError).
        """
        with self._lock():
            self._use(version)

    def _use(self, version: Version | None) -> None:
        if version is not None:
            self.weights(version)
        number = 0 if version is None else version.number
        write_file(self.folder / POINTER, json.dumps({"version": number}).encode())

    def _current_number(self) -> int:
        """Return the number of the version in use; 0 for none."""
        file = self.folder / POINTER
        if not file.exists():
            return 0
        try:
            number = strict_json.parse(file.read_bytes())["version"]
            if type(number) is not int or number < 0:
                raise ValueError(f"version {number!r:.40} is no whole number from 0 on")
            return number
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SpecError(
                f"{file}: cannot be read ({error!r:.200}); choose a version by `slgaussian "
                f"versions {self.folder} --use NUMBER`"
            ) from error

    def _lock(self) -> AbstractContextManager[None]:
        return hold_lock(self.folder / ".lock", "versions", wait=True)

    def _file(self, number: int) -> Path:
        return self.folder / "versions" / f"{number:06d}.parquet"


def mark_clip(clip: str) -> str:
    """Return the mark of a clip in the facts of a version, so that its name need not be there."""
    return hashlib.sha256(clip.encode()).hexdigest()[:16]


def version_name(number: int) -> str:
    """Name a version in words; 0 means none."""
    return f"version {number}" if number else "no version"


def find_weights(place: str | Path) -> Path:
    """Find the weights file: ``place`` itself or, if it is a folder, its version in use.

    Raises:
        InputError: If no version is in use.
        SpecError: If the version in use is damaged.
    """
    if not Path(place).is_dir():
        return Path(place)
    versions = Versions(place)
    current = versions.current()
    if current is None:
        raise InputError(
            f"{place}: no version is in use; expected a file of weights, or a folder in which "
            "`slgaussian retrain` has put a version to use"
        )
    return versions.weights(current)


def _table(version: Version) -> pa.Table:
    row = {**vars(version), "facts": json.dumps(version.facts, sort_keys=True)}
    return pa.Table.from_pylist([row], schema=load_spec("versions").schema)


def _read_record(file: Path) -> Version:
    spec, otherwise = load_spec("versions"), "use another version"
    try:
        table = decode_table(file.read_bytes(), spec, str(file), otherwise)
        (row,) = table.to_pylist()
        facts = strict_json.parse(row["facts"])
        if not isinstance(facts, dict) or not 0 <= row["parent"] < row["number"] == int(file.stem):
            raise ValueError(
                f"it says to be version {row['number']} of parent {row['parent']}, with facts "
                f"{row['facts']:.40}"
            )
        return Version(**{**row, "facts": facts})
    except OSError as error:
        raise SpecError(f"{file}: cannot be read ({error.strerror}); {otherwise}") from error
    except ValueError as error:
        raise SpecError(f"{file}: damaged ({error}); {otherwise}") from error
