"""The fields that a run leaves in its output folder, each as the commands about a field open it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from slgaussian.benchmark.outputs import file_name, write_table
from slgaussian.storage import field_folder
from slgaussian.storage.housekeeping import SIDE_BY_SIDE
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from slgaussian.storage.tables import read_table
from tasks.artifacts import about_field

FOLDER = "fields"
TABLE = "fields"


def place(scene: str, out: Path) -> Path:
    """The folder of a scene's field."""
    return out / FOLDER / file_name(scene)


def check_places(scenes: Iterable[str], out: Path) -> None:
    """Raise InputError now, not after the work, where something else is in a field's place."""
    for scene in scenes:
        field_folder.check_free(place(scene, out))


def write_fields(
    store: ArtifactStore,
    fields: Mapping[str, ArtifactRef],
    places: Mapping[str, str],
    out: Path,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Write the fields by scene below folder ``out``, and a table of them.

    Their files are links to those in the store where there can be any: of all that a run leaves
    they are by far the largest. What is there already stays as it is; fields that an earlier run
    left and this one has not are taken away. ``places`` are those of the encoder's files, and
    ``tell`` is told of what takes time.

    Raises
    ------
    DamagedError
        If an artifact is gone or damaged.
    InputError
        If something is in the way, or the store does not answer.
    OSError
        If a folder cannot be written.
    """
    for folder in _earlier(out) - {file_name(scene) for scene in fields}:
        if (out / FOLDER / folder / field_folder.ABOUT).is_file():
            shutil.rmtree(out / FOLDER / folder)
    rows = [
        {
            "scene": scene,
            "folder": file_name(scene),
            "gaussians": ref.meta["gaussians"],
            "objects": ref.meta["objects"],
        }
        for scene, ref in fields.items()
    ]
    write_table(TABLE, pa.Table.from_pylist(rows, schema=load_spec(TABLE).schema), out)

    def look(scene: str) -> _Kept | None:
        about, parts = about_field(store, fields[scene])
        one = _Kept(place(scene, out), about.to_json(places), parts)
        return None if one.is_there(store) else one

    missing = [one for one in store.at_once(look, list(fields)) if one is not None]
    if missing and not store.near:
        tell(f"copying {len(missing)} fields from {store.root}")
    store.at_once(lambda one: one.write(store), missing, SIDE_BY_SIDE)


def _earlier(out: Path) -> set[str]:
    """The folders that the table of an earlier run names; none if it is no such table."""
    try:
        table = read_table(out / f"{TABLE}.parquet", ["folder"])
        return {name for name in table["folder"].to_pylist() if file_name(name) == name}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, pa.ArrowException):
        return set()


@dataclass(frozen=True)
class _Kept:
    """A field in its folder: ``text`` is that of ``field.json``."""

    folder: Path
    text: str
    parts: Mapping[str, ArtifactRef]

    def is_there(self, store: ArtifactStore) -> bool:
        """Whether it is as :meth:`write` left it."""
        try:
            same = (self.folder / field_folder.ABOUT).read_text("utf-8") == self.text
        except (OSError, ValueError):
            return False
        return same and all(
            store.is_laid_out(ref, self.folder / field_folder.FILES[spec])
            for spec, ref in self.parts.items()
        )

    def write(self, store: ArtifactStore) -> None:
        """Write it whole, or not at all."""
        field_folder.write(
            self.folder, self.text, lambda spec, file: store.lay_out(self.parts[spec], file)
        )
