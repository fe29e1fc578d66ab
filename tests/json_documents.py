"""JSON files against their data specs: the manifest, times, ``field.json``, the index."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from slgaussian.errors import SpecError
from slgaussian.formats import strict_json
from slgaussian.storage.specs import Spec

TYPES: Mapping[str, str | None] = {
    "text": "string", "integer": "integer", "number": "number", "bool": "boolean",
    "object": "object", "list": "array", "any": None,
}  # fmt: skip
"""JSON Schema's names of the types of keys."""


def read_document(data: bytes, spec: Spec, file: str) -> Any:
    """Read a JSON file; SpecError if it contradicts ``spec``."""
    content = strict_json.parse(data)
    json.dumps(content, allow_nan=False)
    check_document(content, spec, file)
    return content


def check_document(content: Any, spec: Spec, file: str) -> None:
    """Raise :class:`SpecError` for the first value that contradicts ``spec``."""
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    error = best_match(Draft202012Validator(json_schema(spec)).iter_errors(content))
    if error is not None:
        place = error.json_path.removeprefix("$").removeprefix(".") or "file"
        raise SpecError(f"{file}: {place}: {error.message:.200}")


def json_schema(spec: Spec) -> dict[str, Any]:
    """Translate the keys of a spec into JSON Schema, 2020-12.

    In the place of a key, ``*`` stands for any name of an object and ``[]`` for each of a list.
    """
    schemas: dict[str, dict[str, Any]] = {"": {"type": "object"}}
    for place, key in sorted(spec.keys.items()):  # whatever holds a key comes before it
        schema = schemas[place] = {}
        if key.type != "any":
            schema["type"] = [TYPES[key.type], *["null"] * key.nullable]
        values = [*key.values, None] if key.values else None
        bounds = {"minimum": key.low, "maximum": key.high, "enum": values}
        schema |= {name: bound for name, bound in bounds.items() if bound is not None}
        if place.endswith("[]"):
            schemas[place[:-2]]["items"] = schema
            continue
        above, _, name = place.rpartition(".")
        if name == "*":
            schemas[above]["additionalProperties"] = schema
            continue
        schemas[above].setdefault("properties", {})[name] = schema
        schemas[above].setdefault("additionalProperties", False)
        if not key.optional:
            schemas[above].setdefault("required", []).append(name)
    return schemas[""]
