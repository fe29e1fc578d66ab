"""What a field was built from, beside it in its folder, so that photographs can be added to it.

Two files that no question needs: ``photographs.json`` says which photographs, where, and how they
were read; ``derived.npz`` holds what was derived of each (:mod:`slgaussian.storage.derived`). A
field without them is whole.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slgaussian.errors import SpecError
from slgaussian.formats import strict_json
from slgaussian.parts.identity import file_digest
from slgaussian.storage.derived import Arrays, Derived
from slgaussian.storage.field_folder import AGAIN
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import encode_arrays, unpacked

FILE = "photographs.json"
DERIVED = "derived.npz"
FORMAT = 1
WHAT = (
    "The photographs that the field in this folder was built from, for `slgaussian field --add`. "
    "No question needs this file or derived.npz."
)


@dataclass(frozen=True)
class Origin:
    """The photographs of a field, and how they were read.

    Attributes
    ----------
    photographs : tuple of (name, place, SHA-256 or None)
        In their order, those that could not be placed among them. The place is a file by its path
        from the root, with its content; or the name of a view that ``cameras`` knows, and None.
    cameras : str or None
        File or folder of their cameras; None if they were found.
    refine : bool
        Whether given cameras were found anew.
    settings : mapping
        Of the command, how photographs are read: size, near, far, and whether cameras are trusted.
    """

    photographs: tuple[tuple[str, str, str | None], ...]
    cameras: str | None
    refine: bool
    settings: Mapping[str, Any]

    @staticmethod
    def of(
        places: Mapping[str, str], cameras: Path | None, refine: bool, settings: Mapping[str, Any]
    ) -> Origin:
        """That of photographs by their names and places: files from the root, or names of views.

        Files are read for their digests.
        """
        known = [
            (name, place, file_digest(place) if os.path.isabs(place) else None)
            for name, place in places.items()
        ]
        where = None if cameras is None else str(cameras.absolute())
        return Origin(tuple(known), where, refine, settings)

    def files(self, derived: Derived) -> dict[str, bytes]:
        """The two files by name; the same of the same."""
        arrays = {
            f"{key}/{name}": array
            for key, own in derived.kept.items()
            for name, array in own.items()
        }
        data = encode_arrays(arrays, load_spec("derived"))
        content = {"format": FORMAT, "what": WHAT, **asdict(self)}
        content["derived"] = hashlib.sha256(data).hexdigest()
        text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
        return {FILE: text.encode(), DERIVED: data}


def read_origin(folder: Path) -> tuple[Origin, dict[str, Arrays]] | None:
    """What the field in ``folder`` was built from, and what was derived; None if it does not say.

    Results that are missing or damaged count as none: they are only an aid.

    Raises
    ------
    SpecError
        If the file is damaged, or of another version.
    """
    file = folder / FILE
    if not file.is_file():
        return None
    try:
        content = strict_json.parse(file.read_bytes())
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']!r:.40}, expected {FORMAT}")
        photographs = tuple((name, place, digest) for name, place, digest in content["photographs"])
        words = [word for own in photographs for word in own if word is not None]
        cameras, refine, settings = (content[name] for name in ("cameras", "refine", "settings"))
        places = [*words, *([] if cameras is None else [cameras])]
        if not words or not all(isinstance(place, str) for place in places):
            raise ValueError("a place is no text")
        origin = Origin(photographs, cameras, bool(refine), dict(settings))
        known = content["derived"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SpecError(f"{file}: damaged ({error}); {AGAIN}") from error
    return origin, _derived(folder / DERIVED, known)


def _derived(file: Path, digest: str) -> dict[str, Arrays]:
    try:
        data = file.read_bytes()
        if hashlib.sha256(data).hexdigest() != digest:
            return {}
        found: dict[str, dict[str, Any]] = {}
        for name, array in unpacked(data)[0].items():
            key, _, own = name.rpartition("/")
            found.setdefault(key, {})[own] = array
    except Exception:  # a damaged file raises almost anything
        return {}
    return dict(found)
