"""The optional file ``photographs.json`` of a field: paths and digests of its photographs.

Only the viewer page reads it, to show the photographs themselves.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from slgaussian.errors import SpecError
from slgaussian.formats import strict_json
from slgaussian.io import file_digest
from slgaussian.storage.field_folder import AGAIN

FILE = "photographs.json"
FORMAT = 2
ABOUT = "The photographs that the field in this folder was built from. No question needs this file."


def describe_photographs(places: Mapping[str, str]) -> dict[str, bytes]:
    """Return the file's content by its name, from the places of photographs by view name.

    A place is the absolute path of a file, which is read to compute its digest, or the name of a
    view in a camera file; entries without a file path are omitted.
    """
    files = {name: place for name, place in places.items() if os.path.isabs(place)}
    photographs = {name: [place, file_digest(place)] for name, place in files.items()}
    content = {"format": FORMAT, "what": ABOUT, "photographs": photographs}
    return {FILE: (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()}


def read_photographs(folder: Path) -> dict[str, tuple[Path, str]]:
    """Return path and SHA-256 (hexadecimal) of a field's photographs by view name.

    Empty if the file is missing or has an earlier version.

    Raises:
        SpecError: If the file is damaged, or has a later version.
    """
    file = folder / FILE
    if not file.is_file():
        return {}
    try:
        content = strict_json.parse(file.read_bytes())
        if content["format"] == 1:
            return {}
        if content["format"] != FORMAT:
            raise ValueError(f"format {content['format']!r:.40}, expected {FORMAT}")
        photographs = {}
        for name, (place, digest) in content["photographs"].items():
            if not isinstance(place, str) or not isinstance(digest, str):
                raise ValueError("a place is not text")
            photographs[name] = Path(place), digest
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SpecError(f"{file}: damaged ({error}); {AGAIN}") from error
    return photographs
