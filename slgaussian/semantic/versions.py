"""Trained weights under one folder: every version kept, one of them in use, all of it traceable.

``versions/000003.parquet`` is what is known of version 3, a row of spec ``versions``, written once
and never changed; ``weights/<digest>.safetensors`` are its weights; ``current.json`` names the
version in use. Each file is written whole or not at all and the pointer last, so whatever is killed
when, the version in use is there. Two that add at the same time get different numbers.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import decode_table, encode_table, sha256_of, write_atomic

POINTER = "current.json"


@dataclass(frozen=True)
class Version:
    """What is known of some weights.

    Attributes
    ----------
    number : int
        From 1, in order of arrival.
    digest : str
        SHA-256 of the weights file, hexadecimal.
    parent : int
        The version that training started from; 0 for none.
    made : str
        When it was added, UTC, ISO 8601.
    promoted : bool
        Whether it was put to use when it was added.
    why : str
        One sentence on that.
    facts : mapping
        Settings, data and scores, as JSON data.
    """

    number: int
    digest: str
    parent: int
    made: str
    promoted: bool
    why: str
    facts: dict[str, Any]


class Versions:
    """The versions in a folder, which is made when first written to."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def all(self) -> list[Version]:
        """Every version, the oldest first.

        Raises
        ------
        SpecError
            If one is damaged.
        """
        files = sorted((self.folder / "versions").glob("[0-9]*.parquet"))
        return [_read(file) for file in files if re.fullmatch(r"\d{6,}", file.stem)]

    def current(self) -> Version | None:
        """The version in use, None if there is none yet.

        Raises
        ------
        SpecError
            If the pointer is damaged or names a version that is not there.
        """
        file = self.folder / POINTER
        if not file.exists():
            return None
        try:
            number = strict_json.parse(file.read_bytes())["version"]
            path = self._file(number)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SpecError(
                f'{file}: cannot be read ({error!r:.200}); write {{"version": NUMBER}} into it'
            ) from error
        return _read(path)

    def weights(self, version: Version) -> Path:
        """The weights file of a version.

        Raises
        ------
        SpecError
            If it is missing or not what was added.
        """
        file = self.folder / "weights" / f"{version.digest}.safetensors"
        if not file.is_file() or sha256_of(file) != version.digest:
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
        """Keep new weights, and put them to use if ``promote``.

        Raises
        ------
        InputError
            If the folder cannot be written; then the version in use is what it was.
        """
        digest = hashlib.sha256(weights).hexdigest()
        try:
            for name in ("weights", "versions"):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            write_atomic(self.folder / "weights" / f"{digest}.safetensors", weights)
            number = self._claim()
            version = Version(
                number,
                digest,
                0 if parent is None else parent.number,
                datetime.now(UTC).isoformat(timespec="seconds"),
                promote,
                why,
                facts,
            )
            write_atomic(self._file(number), encode_table(_table(version)))
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written ({error.strerror or error}); the version in use "
                "stays"
            ) from error
        if promote:
            self.use(version)
        return version

    def use(self, version: Version) -> None:
        """Put a version to use, a new one or an old one again."""
        self.weights(version)
        write_atomic(self.folder / POINTER, json.dumps({"version": version.number}).encode())

    def roll_back(self) -> Version:
        """Put to use what the version in use was trained from, and return it.

        Raises
        ------
        InputError
            If nothing is in use, or it has no parent.
        """
        current = self.current()
        if current is None or not current.parent:
            what = "nothing is in use" if current is None else "the version in use has no parent"
            raise InputError(f"{self.folder}: cannot roll back, as {what}")
        parent = _read(self._file(current.parent))
        self.use(parent)
        return parent

    def _claim(self) -> int:
        """The next number, taken by making an empty file that nobody else can make."""
        taken = [int(f.stem) for f in (self.folder / "versions").iterdir() if f.stem.isdigit()]
        number = max(taken, default=0) + 1
        while True:
            try:
                claim = self.folder / "versions" / f"{number:06d}.claim"
                os.close(os.open(claim, os.O_CREAT | os.O_EXCL))
                return number
            except FileExistsError:
                number += 1

    def _file(self, number: int) -> Path:
        return self.folder / "versions" / f"{number:06d}.parquet"


def weights_in(folder: str | os.PathLike[str]) -> Path:
    """The weights file of the version in use in a folder.

    Raises
    ------
    InputError
        If nothing is in use.
    SpecError
        If what is in use is damaged.
    """
    versions = Versions(folder)
    current = versions.current()
    if current is None:
        raise InputError(
            f"{folder}: no version is in use; expected a file of weights, or a folder in which "
            "`slgaussian retrain` has put a version to use"
        )
    return versions.weights(current)


def _table(version: Version) -> pa.Table:
    row = {**vars(version), "facts": json.dumps(version.facts, sort_keys=True)}
    return pa.Table.from_pylist([row], schema=load_spec("versions").schema)


def _read(file: Path) -> Version:
    spec, otherwise = load_spec("versions"), "use another version"
    try:
        table = decode_table(file.read_bytes(), spec, str(file), otherwise)
        (row,) = table.to_pylist()
        return Version(**{**row, "facts": strict_json.parse(row["facts"])})
    except OSError as error:
        raise SpecError(f"{file}: cannot be read ({error.strerror}); {otherwise}") from error
    except ValueError as error:
        raise SpecError(f"{file}: damaged ({error}); {otherwise}") from error
