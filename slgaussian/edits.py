"""A user's edits of a field, stored in its folder: taught words, names, removed objects.

They are two optional files, ``words.npz`` and ``edits.npz``. The Gaussians are not modified, so
every edit can be undone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.io import write_atomic
from slgaussian.language.taught import TaughtWords, normalize
from slgaussian.storage.encoding import Arrays, decode_arrays, encode_artifact
from slgaussian.storage.field_folder import read_content
from slgaussian.storage.specs import load_spec

FILES = {"words": "words.npz", "edits": "edits.npz"}
"""Names of the files by data spec."""

REPAIR = {
    "words": "remove the file, and teach the words again",
    "edits": "remove edits.npz to have the field as it was built",
}


@dataclass(frozen=True, eq=False)
class Edits:
    """Edits of a field, none by default.

    Attributes:
        taught: Words taught by example; in queries they take precedence over the encoder.
        names: {id: str}. Names of objects. In a query a name matches exactly these objects, and
            takes precedence over taught words and the encoder.
        removed: frozenset of int. Ids of objects that are neither rendered nor found. Their
            Gaussians remain, so that they can be restored.
    """

    taught: TaughtWords = field(default_factory=TaughtWords)
    names: Mapping[int, str] = field(default_factory=dict)
    removed: frozenset[int] = frozenset()

    def rename(self, object_id: int, name: str) -> Edits:
        """Return the edits with a name for an object; an empty name deletes it.

        InputError if the name is too long.
        """
        names = {id_: name_ for id_, name_ in self.names.items() if id_ != object_id}
        if plain := " ".join(name.split()):
            normalize(plain)
            names[int(object_id)] = plain
        return replace(self, names=names)

    def to_files(self) -> dict[str, bytes]:
        """Encode the edits as files by name; without edits there are none."""
        contents: dict[str, Arrays] = {}
        if len(self.taught):
            contents["words"] = self.taught.to_arrays()
        if self.names or self.removed:
            ids = sorted(self.names)
            contents["edits"] = {
                "named": np.array(ids, np.int32),
                "names": np.array([self.names[id_] for id_ in ids], np.str_),
                "removed": np.array(sorted(self.removed), np.int32),
            }
        return {
            FILES[spec]: encode_artifact(spec, arrays, FILES[spec])[1]
            for spec, arrays in contents.items()
        }

    def write(self, folder: Path) -> None:
        """Write the edits to the folder of a field, and delete those that it had before.

        InputError if the folder cannot be written.
        """
        files = self.to_files()
        try:
            for name in FILES.values():
                if name in files:
                    write_atomic(folder / name, files[name])
                else:
                    (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be written ({error.strerror}); choose a folder that you may "
                "write to, on a disk with room"
            ) from error

    @staticmethod
    def read(folder: Path, encoder: str, ids: np.ndarray) -> Edits:
        """Read the edits in a field's folder.

        Args:
            encoder: From :func:`slgaussian.language.taught.encoder_identity`.
            ids: int32 [N]. Ids of the field's objects.

        Raises:
            SpecError: If a file is damaged, its words have another encoder, or an object is not in
                the field.
        """
        edits = Edits()
        if words := _read(folder, "words"):
            try:
                edits = Edits(TaughtWords.from_arrays(words, encoder))
            except (InputError, SpecError) as error:
                file = folder / FILES["words"]
                raise SpecError(f"{file}: {error}; {REPAIR['words']}") from error
        if arrays := _read(folder, "edits"):
            strange = np.setdiff1d(np.concatenate([arrays["named"], arrays["removed"]]), ids)
            if len(strange):
                raise SpecError(
                    f"{folder / FILES['edits']}: object {strange[0]} is not in this field; "
                    f"{REPAIR['edits']}"
                )
            named = zip(arrays["named"].tolist(), arrays["names"].tolist(), strict=True)
            removed = frozenset(arrays["removed"].tolist())
            edits = replace(edits, names=dict(named), removed=removed)
        return edits


def _read(folder: Path, spec: str) -> Arrays | None:
    """Read a file of edits; None if there is none."""
    file, repair = folder / FILES[spec], REPAIR[spec]
    if not file.is_file():
        return None
    return decode_arrays(read_content(file, repair), load_spec(spec), str(file), repair)
