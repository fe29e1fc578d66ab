"""JSON documents that people write or download: read, checked, and refused in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from slgaussian.errors import InputError
from slgaussian.formats import strict_json

Model = TypeVar("Model", bound=BaseModel)


def read_json(path: Path, kind: str) -> Any:
    """Read a JSON file; InputError, which calls it a ``kind``, if it cannot be read."""
    try:
        return strict_json.parse(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot read the {kind} ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: the {kind} is not valid JSON ({error})") from error


def check_document(model: type[Model], content: Any, where: str) -> Model:
    """Return content as a model; InputError that names the first field that is wrong.

    ``where`` is the file, or a part of it.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "it"
        value = "missing" if first["type"] == "missing" else f"{first['input']!r:.60}"
        reason = first["msg"].removeprefix("Value error, ")
        raise InputError(f"{where}: {place} is {value}; {reason}") from None
