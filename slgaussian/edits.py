"""A user's edits of a field, stored in its folder: taught words, names, removed objects.

They are two optional files, ``words.npz`` and ``edits.npz``. The Gaussians are not modified, so
every edit can be undone.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.io import write_atomic
from slgaussian.language.taught import TaughtWords
from slgaussian.storage.encoding import decode_arrays, encode_artifact
from slgaussian.storage.specs import load_spec

WORDS = "words.npz"
EDITS = "edits.npz"
REPAIR = f"remove {EDITS} to have the field as it was built"


def files(taught: TaughtWords, names: Mapping[int, str], removed: Set[int]) -> dict[str, bytes]:
    """Encode the files by name; without edits there are none."""
    files = {}
    if len(taught):
        files[WORDS] = taught.to_bytes()
    if names or removed:
        ids = sorted(names)
        arrays = {
            "named": np.array(ids, np.int32),
            "names": np.array([names[id_] for id_ in ids], np.str_),
            "removed": np.array(sorted(removed), np.int32),
        }
        files[EDITS] = encode_artifact("edits", arrays, EDITS)[1]
    return files


def write(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write :func:`files` to the folder of a field, and delete edits that are not among them.

    InputError if the folder cannot be written.
    """
    try:
        for name in (WORDS, EDITS):
            if name in files:
                write_atomic(folder / name, files[name])
            else:
                (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written ({error.strerror}); choose a folder that you may write "
            "to, on a disk with room"
        ) from error


def read(folder: Path, encoder: str, ids: np.ndarray) -> dict[str, Any]:
    """Read the edits in a field's folder, attributes of a field by name: taught, names, removed.

    Args:
        encoder: From :func:`slgaussian.language.taught.encoder_identity`.
        ids: int32 [N]. Ids of the field's objects.

    Raises:
        SpecError: If a file is damaged, its words have another encoder, or an object is not in the
            field.
    """
    edits: dict[str, Any] = {}
    file = folder / WORDS
    if file.is_file():
        edits["taught"] = TaughtWords.from_bytes(_content(file), str(file), encoder)
    file = folder / EDITS
    if file.is_file():
        arrays = decode_arrays(_content(file), load_spec("edits"), str(file), repair=REPAIR)
        strange = np.setdiff1d(np.concatenate([arrays["named"], arrays["removed"]]), ids)
        if len(strange):
            raise SpecError(f"{file}: object {strange[0]} is not in this field; {REPAIR}")
        named = zip(arrays["named"].tolist(), arrays["names"].tolist(), strict=True)
        edits |= {"names": dict(named), "removed": frozenset(arrays["removed"].tolist())}
    return edits


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise SpecError(f"{file}: cannot be read ({error.strerror})") from error
