"""JSON files against their data specs: the manifest, times, ``field.json``, the index, the log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from slgaussian.formats import strict_json
from slgaussian.storage.specs import Key, Spec, check_bounds, mismatch

TYPES: Mapping[str, Any] = {
    "text": str,
    "integer": int,
    "number": (int, float),
    "bool": bool,
    "object": dict,
    "list": list,
    "any": object,
}


def read_document(data: bytes, spec: Spec, file: str) -> Any:
    """What a JSON file holds, or the list of its lines; SpecError if it is not what ``spec`` says.

    Of a log of a run that was killed, the last line may be cut short: it counts as not written.
    """
    try:
        if not spec.lines:
            content = strict_json.parse(data)
        else:
            content = [strict_json.parse(line) for line in data.split(b"\n")[:-1]]
    except ValueError as error:
        raise mismatch(
            file, "file", f"no JSON ({error})", f"a {spec.name} of {spec.label}"
        ) from None
    check_document(content, spec, file)
    return content


def check_document(content: Any, spec: Spec, file: str) -> None:
    """Raise :class:`SpecError` at the first value that is not what ``spec`` says."""
    tree = _tree(spec)
    for number, one in enumerate(content if spec.lines else [content]):
        place = f"{file}: line {number + 1}" if spec.lines else file
        if not isinstance(one, dict):
            raise mismatch(place, "file", type(one).__name__, "an object")
        _check_keys(one, tree, "", place)


class _Node:
    """A key and those below it."""

    def __init__(self) -> None:
        self.key: Key | None = None
        self.below: dict[str, _Node] = {}


def _tree(spec: Spec) -> _Node:
    root = _Node()
    for place, key in spec.keys.items():
        node = root
        for part in place.replace("[]", ".[]").split("."):
            node = node.below.setdefault(part, _Node())
        node.key = key
    return root


def _check_keys(content: Mapping[str, Any], node: _Node, place: str, file: str) -> None:
    known = node.below
    for name, child in known.items():
        if name == "*" or name in content or child.key is None or child.key.optional:
            continue
        raise mismatch(file, f"{place}{name}", "nothing", _described(child.key))
    for name, value in content.items():
        own = known.get(name, known.get("*"))
        if own is None:
            raise mismatch(file, f"{place}{name}", "an unknown key", f"only {', '.join(known)}")
        _check(value, own, f"{place}{name}", file)


def _check(value: Any, node: _Node, place: str, file: str) -> None:
    key = node.key
    if key is None or (value is None and key.nullable):
        return
    found = f"{value!r:.80}"
    fits = isinstance(value, TYPES[key.type])
    if isinstance(value, bool) and key.type not in ("bool", "any"):
        fits = False
    if not fits or (isinstance(value, float) and not math.isfinite(value)):
        raise mismatch(file, place, found, _described(key))
    if key.values and value not in key.values:
        raise mismatch(file, place, found, f"one of {list(key.values)}")
    if isinstance(value, (int, float)):
        check_bounds(value, value, key, place, file)
    if node.below and isinstance(value, dict):
        _check_keys(value, node, f"{place}.", file)
    if isinstance(value, list) and "[]" in node.below:
        for number, entry in enumerate(value):
            _check(entry, node.below["[]"], f"{place}[{number}]", file)


def _described(key: Key) -> str:
    article = "an" if key.type[0] in "aio" else "a"
    return f"{article} {key.type}" if key.type != "any" else "a value"
