"""The folder in which a semantic field is stored, whose files are also artifacts of a store.

``field.json`` describes the folder: program and settings, cameras, and the digests of the other
files, each of which is named after its data spec. A run stores the same files in its artifact
store, and its output folder contains links to them.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian import __version__
from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.io import atomic_folder, explain_write_errors, file_digest
from slgaussian.scene import Camera, Estimated
from slgaussian.storage.encoding import Arrays, arrays_digest, decode_arrays
from slgaussian.storage.specs import load_spec, mismatch
from slgaussian.storage.store import is_digest

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = 1
"""Version of the format of the folder. Folders without a version are older."""

FIELD_FILE = "field.json"
FILES = {"gaussians": "gaussians.npz", "bank": "bank.npz", "objects": "objects.parquet"}
"""Names of the other files by data spec."""

PHOTOGRAPHS = "photographs.json"
"""Optional file with paths and digests of the photographs, which the viewer page shows."""

DESCRIPTION = (
    "A semantic field: 3D Gaussians that carry ID codes (gaussians.npz), the memory bank that says "
    "what the codes mean (bank.npz), and its objects (objects.parquet). Cameras are those of the "
    "context views: K in pixels, pixel centres at +0.5; c2w camera-to-world, OpenCV axes (x right, "
    "y down, z forward), scene units. Open it with slgaussian query, render or export, or with "
    "slgaussian.SemanticField.load."
)
REPAIR = "build the field again"


@dataclass(frozen=True, eq=False)
class About:
    """Content of ``field.json``, which does not depend on the location of the field.

    Attributes:
        settings: Names and settings of all components, files by digest; descriptions of the result
            under ``quality``, ``verdict`` and ``account``.
        cameras: mapping str -> Camera. The context cameras by view name.
        digests: {spec: SHA-256}. Content digests of the other files, by
            :func:`slgaussian.storage.encoding.encode_artifact`.
    """

    settings: Mapping[str, Any]
    cameras: Mapping[str, Camera]
    digests: Mapping[str, str]

    def to_json(self, places: Mapping[str, str] | None = None) -> str:
        """Return the text of the file; ``places`` are the locations of the encoder's files."""
        content = {
            "format": FORMAT,
            "what": DESCRIPTION,
            "made_by": f"slgaussian {__version__}",
            "settings": json.loads(json.dumps(dict(self.settings), sort_keys=True)),
            "cameras": {name: _camera_json(camera) for name, camera in self.cameras.items()},
            "files": {FILES[spec]: digest for spec, digest in self.digests.items()},
            "places": {key: str(place) for key, place in (places or {}).items()},
        }
        return json.dumps(content, indent=1) + "\n"

    @staticmethod
    def from_json(text: str | bytes, file: str) -> tuple[About, dict[str, str]]:
        """Parse the text of :meth:`to_json`; return the content and ``places``.

        Raises:
            SpecError: If the text is damaged or has another version of the format. The message
                names ``file``.
        """
        try:
            content = strict_json.parse(text)
            version, maker = content.get("format"), content.get("made_by")
            if version != FORMAT:
                stated = "none" if version is None else repr(version)[:40]
                maker_text = f", made by {maker:.60}" if isinstance(maker, str) else ""
                raise mismatch(file, "format", f"{stated}{maker_text}", f"{FORMAT}; {REPAIR}")
            cameras = {name: _parse_camera(values) for name, values in content["cameras"].items()}
            settings, places = dict(content["settings"]), dict(content["places"])
            settings["encoder"], settings.get(settings["encoder"], {}).items()
            if not all(isinstance(place, str) for place in places.values()):
                raise ValueError("a place is not text")
            digests = {spec: content["files"][name] for spec, name in FILES.items()}
            if not all(map(is_digest, digests.values())):
                raise ValueError("a digest is not a SHA-256")
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise SpecError(f"{file}: damaged ({error}); {REPAIR}") from error
        return About(settings, cameras, digests), places


def _camera_json(camera: Camera) -> dict[str, Any]:
    values = {field.name: getattr(camera, field.name) for field in fields(camera)}
    values |= {"K": camera.K.tolist(), "c2w": camera.c2w.tolist()}
    estimated = values.pop("estimated")
    return values if estimated is None else {**values, "estimated": asdict(estimated)}


def _parse_camera(values: Mapping[str, Any]) -> Camera:
    arrays: dict[str, Any] = {name: np.array(values[name]) for name in ("K", "c2w")}
    if values.get("estimated") is not None:
        arrays["estimated"] = Estimated.of(values["estimated"])
    return Camera(**{**values, **arrays})


def write(
    path: Path,
    text: str,
    fill: Callable[[str, Path], object],
    beside: Mapping[str, bytes] | None = None,
) -> None:
    """Write a folder completely or not at all, replacing a field at the same path.

    Args:
        text: ``field.json``, by :meth:`About.to_json`.
        fill: Writes the file of a spec of :data:`FILES` to a path.
        beside: mapping str -> bytes, optional. Further files of the folder by name, such as that of
            :func:`describe_photographs`.

    Raises:
        InputError: If the folder cannot be written, or exists and is not a field.
    """
    check_target(path)
    with atomic_folder(path) as draft:
        for spec, name in FILES.items():
            fill(spec, draft / name)
        for name, data in (beside or {}).items():
            (draft / name).write_bytes(data)
        (draft / FIELD_FILE).write_text(text, "utf-8")


def read_about(path: Path) -> tuple[About, dict[str, str]]:
    """Read ``field.json`` of a folder, and the locations of the encoder's files.

    Raises:
        SpecError: If the file is missing, damaged, or has another version of the format.
    """
    file = path / FIELD_FILE
    if not file.is_file():
        raise SpecError(
            f"{path}: no {FIELD_FILE} there, expected a folder that `slgaussian field` or a run "
            "(under fields/ of its results) or SemanticField.save wrote"
        )
    return About.from_json(read_content(file), str(file))


def read_arrays(path: Path, digests: Mapping[str, str]) -> dict[str, Arrays]:
    """Read ``bank`` and ``gaussians`` of a folder; SpecError if one has not its digest."""
    contents: dict[str, Arrays] = {}
    for spec in ("bank", "gaussians"):
        file, digest = path / FILES[spec], digests[spec]
        contents[spec] = read_file(file, spec)
        if (actual := arrays_digest(contents[spec])) != digest:
            problem = f"it was changed or belongs to another field; {REPAIR}"
            expected = f"{digest[:12]} by {FIELD_FILE}: {problem}"
            raise mismatch(str(file), "digest", f"content {actual[:12]}", expected)
    return contents


def read_file(file: Path, spec: str, repair: str = REPAIR) -> Arrays:
    """Read the arrays of a file of a folder; SpecError, with advice, if it is damaged."""
    return decode_arrays(read_content(file, repair), load_spec(spec), str(file), repair)


def tabulate_objects(ids: np.ndarray, codes: np.ndarray, labels: np.ndarray) -> pa.Table:
    """Make the table of objects: id, code and number of Gaussians with this main object."""
    import pyarrow as pa

    rows = np.searchsorted(ids, labels[labels > 0])  # ids are positive and ascending
    columns = [ids.astype(np.int64), *codes.T.astype(np.float64), np.bincount(rows, None, len(ids))]
    return pa.table(columns, schema=load_spec("objects").schema)


def read_content(file: Path, repair: str = REPAIR) -> bytes:
    """Read a file of a folder; SpecError with the advice ``repair`` if it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise SpecError(f"{file}: {error.strerror}; {repair}") from error


def describe_photographs(places: Mapping[str, str]) -> dict[str, bytes]:
    """Return the content of :data:`PHOTOGRAPHS` by its name, from places of photographs by view.

    A place is the absolute path of a file, which is read to compute its digest, or the name of a
    view in a camera file; the latter are omitted.
    """
    files = {name: place for name, place in places.items() if os.path.isabs(place)}
    content = {
        "what": "The photographs of the field in this folder. No question needs this file.",
        "photographs": {name: [place, file_digest(place)] for name, place in files.items()},
    }
    return {PHOTOGRAPHS: (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()}


def read_photographs(folder: Path) -> dict[str, tuple[Path, str]]:
    """Return path and SHA-256 (hexadecimal) of a field's photographs by view name, if recorded.

    Raises:
        SpecError: If the file is damaged.
    """
    file = folder / PHOTOGRAPHS
    if not file.is_file():
        return {}
    try:
        entries = strict_json.parse(file.read_bytes())["photographs"].items()
        return {name: (Path(place), str(digest)) for name, (place, digest) in entries}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SpecError(f"{file}: damaged ({error}); {REPAIR}") from error


def check_same_photographs(folder: Path, places: Mapping[str, str]) -> None:
    """Check that the field in a folder, if there is one, is of the same photographs by content.

    Args:
        places: As for :func:`describe_photographs`. If none is a file, the names count.

    Raises:
        InputError: If it is of other photographs, or cannot be read.
    """
    if not (folder / FIELD_FILE).is_file():
        return
    digests = sorted(file_digest(place) for place in places.values() if os.path.isabs(place))
    with suppress(SpecError):
        about, _ = read_about(folder)
        recorded = sorted(digest for _, digest in read_photographs(folder).values())
        if recorded == digests if digests else set(about.cameras) <= set(places):
            return
    raise InputError(
        f"{folder}: holds a field of other photographs; choose another folder, or give --force to "
        "replace it"
    )


def check_target(path: Path, marker: str = FIELD_FILE, kind: str = "a field") -> None:
    """Create the parents of ``path`` and check that a field can be written there.

    Other kinds of folder are recognised by a file named ``marker``, and called ``kind`` in
    messages. Call it before the work, so that no work is lost if the folder cannot be written.

    Raises:
        InputError: If a parent cannot be created or written, or ``path`` exists and is not such a
            folder.
    """
    check_free(path, marker, kind)
    with explain_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        os.rmdir(tempfile.mkdtemp(prefix=".probe-", dir=path.parent))


def check_free(path: Path, marker: str = FIELD_FILE, kind: str = "a field") -> None:
    """Raise :class:`InputError` if ``path`` exists, is not empty and is not ``kind``."""
    empty = path.is_dir() and not any(path.iterdir())
    if path.exists() and not (path / marker).is_file() and not empty:
        raise InputError(f"{path}: exists and is not {kind}; choose another folder, or remove it")
