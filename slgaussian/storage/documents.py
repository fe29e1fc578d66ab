"""JSON files against their data specs: the manifest, times, ``field.json``, the index, the log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NoReturn

from slgaussian.formats import strict_json
from slgaussian.storage.specs import Entry, Spec, check_bounds, mismatch

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
    """Read a JSON file, or the list of its lines; SpecError if it is not what ``spec`` says.

    Of a log of a run that was killed, the last line may be cut short: it counts as not written.
    """
    try:
        if not spec.lines:
            content = strict_json.parse(data)
        else:
            content = [strict_json.parse(line) for line in data.split(b"\n")[:-1]]
    except ValueError as error:
        expected = f"a {spec.name} of {spec.label}"
        raise mismatch(file, "file", f"no JSON ({error})", expected) from None
    check_document(content, spec, file)
    return content


def check_document(content: Any, spec: Spec, file: str) -> None:
    """Raise :class:`SpecError` at the first value that is not what ``spec`` says."""
    for number, entry in enumerate(content if spec.lines else [content], 1):
        place = f"{file}: line {number}" if spec.lines else file
        if not isinstance(entry, dict):
            raise mismatch(place, "file", type(entry).__name__, "an object")
        _Checker(spec, place).check_object(entry, "", "")


class _Checker:
    """A check of values by the places of their keys.

    ``shown`` is a place with the names and numbers that stand for ``*`` and ``[]``.
    """

    def __init__(self, spec: Spec, file: str) -> None:
        self.keys, self.file = spec.keys, file
        self.below: dict[str, dict[str, str]] = {}
        for place in spec.keys:
            is_entry = place.endswith("[]")
            above, name = (place[:-2], "[]") if is_entry else place.rpartition(".")[::2]
            self.below.setdefault(above, {})[name] = place

    def check_object(self, content: Mapping[str, Any], place: str, shown: str) -> None:
        places = self.below[place]
        for name, own in places.items():
            if name != "*" and name not in content and not self.keys[own].optional:
                self.refuse(f"{shown}{name}", "nothing", _type_text(self.keys[own]))
        for name, value in content.items():
            matching = places.get(name, places.get("*"))
            if matching is None:
                self.refuse(f"{shown}{name}", "an unknown key", f"only {', '.join(places)}")
            self.check_value(value, matching, f"{shown}{name}")

    def check_value(self, value: Any, place: str, shown: str) -> None:
        key = self.keys[place]
        if value is None and key.nullable:
            return
        fits = isinstance(value, TYPES[key.type])
        fits &= not isinstance(value, bool) or key.type in ("bool", "any")
        if not fits or (isinstance(value, float) and not math.isfinite(value)):
            self.refuse(shown, f"{value!r:.80}", _type_text(key))
        if key.values and value not in key.values:
            self.refuse(shown, f"{value!r:.80}", f"one of {list(key.values)}")
        if isinstance(value, (int, float)):
            check_bounds(value, value, key, shown, self.file)
        if isinstance(value, dict) and place in self.below:
            self.check_object(value, place, f"{shown}.")
        if isinstance(value, list) and place in self.below:
            for number, entry in enumerate(value):
                self.check_value(entry, self.below[place]["[]"], f"{shown}[{number}]")

    def refuse(self, place: str, found: str, expected: str) -> NoReturn:
        raise mismatch(self.file, place, found, expected)


def _type_text(key: Entry) -> str:
    article = "an" if key.type[0] in "aio" else "a"
    return f"{article} {key.type}" if key.type != "any" else "a value"
