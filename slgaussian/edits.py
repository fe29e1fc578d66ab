"""A user's edits of a field, stored in its folder: taught words, names, removed objects.

They are two optional files, ``words.npz`` and ``edits.npz``. The Gaussians are not modified, so
every edit can be undone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.io import explain_write_errors, write_atomic
from slgaussian.language.bank import MemoryBank
from slgaussian.language.taught import TaughtWords, normalize
from slgaussian.semantic.boundary_gaussians import boundary_gaussians
from slgaussian.storage.encoding import arrays_digest, encode_artifact
from slgaussian.storage.field_folder import read_about, read_file

if TYPE_CHECKING:
    from slgaussian.field import SemanticField

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

    def teach(self, word: str, object_id: int, bank: MemoryBank, encoder: str) -> Edits:
        """Return the edits with an object as an example of ``word``, the others as its rivals.

        ``encoder`` as in :meth:`read`. InputError if there is no such object, no view shows it, or
        the word cannot be used.
        """
        row, (rows, features) = bank.row(object_id), bank.mean_features()
        if row not in rows:
            raise InputError(f"object {object_id}: no view holds it, so it is like nothing")
        example, rivals = features[rows == row][0], features[rows != row]
        return replace(self, taught=self.taught.add_example(word, example, rivals, encoder))

    def forget(self, word: str) -> Edits:
        """Return the edits without a taught word; InputError if it is not taught."""
        return replace(self, taught=self.taught.remove(word))

    def rename(self, object_id: int, name: str, bank: MemoryBank) -> Edits:
        """Return the edits with a name for an object; an empty name deletes it.

        InputError if there is no such object, or the name is too long.
        """
        bank.row(object_id)
        names = {id_: name_ for id_, name_ in self.names.items() if id_ != object_id}
        if plain := " ".join(name.split()):
            normalize(plain)
            names[int(object_id)] = plain
        return replace(self, names=names)

    def hide(self, ids: Iterable[int], bank: MemoryBank) -> Edits:
        """Return the edits with these objects removed; InputError if one does not exist."""
        return replace(self, removed=self.removed | bank.check_ids(ids))

    def restore(self, ids: Iterable[int], bank: MemoryBank, labels: np.ndarray) -> Edits:
        """Return the edits with these objects restored.

        InputError if one does not exist, or is not among the ``labels`` int32 [N] of the Gaussians.
        """
        restored = bank.check_ids(ids)
        if missing := restored - set(labels.tolist()):
            raise InputError(
                f"object {min(missing)}: its Gaussians are not in this field; open the one that it "
                "was removed from"
            )
        return replace(self, removed=self.removed - restored)

    def to_files(self) -> dict[str, bytes]:
        """Encode the edits as files by name; without edits there are none."""
        contents = {"words": self.taught.to_arrays()} if len(self.taught) else {}
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

    def write(self, folder: Path, bank: MemoryBank) -> None:
        """Write the edits to the folder of a field, and delete those that it had before.

        InputError if the folder cannot be written, or its field has another bank than ``bank``.
        """
        about, _ = read_about(folder)
        if about.digests["bank"] != arrays_digest(bank.to_arrays()):
            raise InputError(f"{folder}: is the folder of another field; save this one as a whole")
        files = self.to_files()
        with explain_write_errors(folder):
            for name in FILES.values():
                if name in files:
                    write_atomic(folder / name, files[name])
                else:
                    (folder / name).unlink(missing_ok=True)

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
        file, repair = folder / FILES["words"], REPAIR["words"]
        if file.is_file():
            arrays = read_file(file, "words", repair)
            try:
                edits = Edits(TaughtWords.from_arrays(arrays, encoder))
            except (InputError, SpecError) as error:
                raise SpecError(f"{file}: {error}; {repair}") from error
        file, repair = folder / FILES["edits"], REPAIR["edits"]
        if file.is_file():
            arrays = read_file(file, "edits", repair)
            strange = np.setdiff1d(np.concatenate([arrays["named"], arrays["removed"]]), ids)
            if len(strange):
                raise SpecError(f"{file}: object {strange[0]} is not in this field; {repair}")
            named = zip(arrays["named"].tolist(), arrays["names"].tolist(), strict=True)
            removed = frozenset(arrays["removed"].tolist())
            edits = replace(edits, names=dict(named), removed=removed)
        return edits


def find_hidden(
    field: SemanticField, whole_views: dict[str, tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Find the Gaussians of removed objects and along their boundaries, bool [N].

    Args:
        whole_views: {name: (ids, depth)} of context views with all objects; those that are missing
            are rendered and added.
    """
    ids = list(field.edits.removed)
    hidden = np.isin(field.labels(), ids)
    if not hidden.any():
        return hidden
    shown = np.any(field.bank.present[np.isin(field.bank.ids, ids)], axis=0)
    cameras = dict(compress(field.cameras.items(), shown))
    whole = field.with_changes(edits=replace(field.edits, removed=frozenset()))
    for name in cameras.keys() - whole_views.keys():
        view = whole.render(cameras[name])
        whole_views[name] = view.ids, view.depth
    depths = [whole_views[name][1] for name in cameras]
    masks = [np.isin(whole_views[name][0], ids) for name in cameras]
    means = field.gaussians.to_arrays()["means"]
    local_cameras = [field.gaussians.localize(camera) for camera in cameras.values()]
    return hidden | boundary_gaussians(means, hidden, local_cameras, depths, masks)
