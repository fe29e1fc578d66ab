"""Reading and validation of JSON documents, with errors in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from slgaussian.components.config import explain
from slgaussian.errors import InputError
from slgaussian.formats import strict_json

Model = TypeVar("Model", bound=BaseModel)


def read_json(path: Path, kind: str) -> Any:
    """Read a JSON file; raise an InputError that calls it a ``kind`` if it cannot be read."""
    try:
        return strict_json.parse(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot read the {kind} ({error.strerror})") from error
    except ValueError as error:
        raise InputError(f"{path}: the {kind} is not valid JSON ({error})") from error


def check_document(model: type[Model], content: Any, label: str) -> Model:
    """Validate content with a pydantic model; InputError names the first invalid field.

    ``label`` is the file, or a part of it, for the message.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{label}: {explain(error, model)}") from None
