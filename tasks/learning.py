"""Lessons and weights as they are stored, and back."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from slgaussian.semantic.branch import Branch, load_branch, save_branch
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.encoding import Arrays
from slgaussian.storage.store import ArtifactRef, ArtifactStore


class StoredLessons(Sequence[Lesson]):
    """The lessons that a table of spec ``lessons`` lists, each read when it is asked for."""

    def __init__(self, store: ArtifactStore, table: pa.Table) -> None:
        self.store = store
        self.clips: list[str] = table["clip"].to_pylist()
        places = zip(table["uri"].to_pylist(), table["digest"].to_pylist(), strict=True)
        self.refs = [ArtifactRef("lesson", *place) for place in places]

    def __len__(self) -> int:
        return len(self.refs)

    def __getitem__(self, index: int) -> Lesson:  # type: ignore[override]  # no slices are asked
        return Lesson.from_arrays(self.store.get(self.refs[index]))


def branch_to_arrays(branch: Branch) -> Arrays:
    """A branch as spec ``weights``."""
    return {"safetensors": np.frombuffer(save_branch(branch), np.uint8)}


def branch_from_arrays(arrays: Arrays) -> Branch:
    """Inverse of :func:`branch_to_arrays`."""
    # Read through a file, as what is given by hand is: metadata come from files alone.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "branch.safetensors"
        file.write_bytes(arrays["safetensors"].tobytes())
        return load_branch(file)
