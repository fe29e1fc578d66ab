"""Types of fields that accept text as well, and the JSON schema for the form of Prefect's page."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PositiveInt, StringConstraints, WithJsonSchema

from slgaussian.errors import did_you_mean

ALLOWED_SIDES = range(16, 8193)
"""Allowed heights and widths of views, in pixels."""

AT_MOST_PREFIX = "at most "

RUNNERS = ("threads", "processes")
"""Runners on this machine."""

PORTS = {"dask": 8786, "ray": 10001}
"""Usual port of a running cluster."""

_RUNNER_PATTERN = re.compile(rf"^({'|'.join(RUNNERS)}|({'|'.join(PORTS)})://.+:[0-9]+)$")


def _parse_sides(value: Any) -> tuple[int, int]:
    """Parse height and width from ``"256x256"``, as on the command line, or from a pair."""
    try:
        height, width = map(int, value.split("x") if isinstance(value, str) else value)
    except (TypeError, ValueError):
        height = width = 0
    if height not in ALLOWED_SIDES or width not in ALLOWED_SIDES:
        raise ValueError(
            f"expected height and width as in 256x256, each from {ALLOWED_SIDES[0]} to "
            f"{ALLOWED_SIDES[-1]}"
        )
    return height, width


def _parse_size(value: Any) -> tuple[int, int] | str:
    """Parse height and width, or one of the texts for sizes."""
    if value in ("auto", "original"):
        return value
    bound = isinstance(value, str) and value.startswith(AT_MOST_PREFIX)
    try:
        sides = _parse_sides(value.removeprefix(AT_MOST_PREFIX) if bound else value)
    except ValueError as error:
        raise ValueError(f"{error}, 'at most 416x576', 'auto' or 'original'") from None
    return "{}{}x{}".format(AT_MOST_PREFIX, *sides) if bound else sides


def _parse_runner(value: Any) -> str:
    text = str(value)
    if _RUNNER_PATTERN.match(text):
        return text
    kind = text.partition("://")[0]
    advice = did_you_mean(kind, (*RUNNERS, *PORTS))
    if kind in PORTS:
        advice = f"; give the address of the running cluster, as {kind}://host:{PORTS[kind]}"
    raise ValueError(
        "expected threads, processes, or for a cluster that runs dask://host:port or "
        f"ray://host:port{advice}"
    )


def _schema(pattern: str, items: dict[str, Any] | None = None) -> WithJsonSchema:
    """Return the schema of a field that accepts text, and a list with these ``items``."""
    text = {"type": "string", "pattern": pattern}
    return WithJsonSchema({"anyOf": [text, {"type": "array", **items}]} if items else text)


_SIDE = {"type": "integer", "minimum": ALLOWED_SIDES[0], "maximum": ALLOWED_SIDES[-1]}
_PAIR = {"items": _SIDE, "minItems": 2, "maxItems": 2}

Sides = Annotated[tuple[int, int], BeforeValidator(_parse_sides), _schema("^[0-9]+x[0-9]+$", _PAIR)]
Size = Annotated[
    tuple[int, int] | str,
    BeforeValidator(_parse_size),
    _schema(f"^(auto|original|({AT_MOST_PREFIX})?[0-9]+x[0-9]+)$", _PAIR),
]
Runner = Annotated[str, BeforeValidator(_parse_runner), _schema(_RUNNER_PATTERN.pattern)]
Phrase = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
Widths = Annotated[
    tuple[PositiveInt, ...],
    BeforeValidator(lambda value: value.split(",") if isinstance(value, str) else value),
    Field(min_length=1),
    _schema("^[0-9]+(,[0-9]+)*$", {"items": {"type": "integer", "minimum": 1}, "minItems": 1}),
]
"""Numbers of channels: a list, or text as in 8,16,24,32."""


def with_default(text: str, default: Any) -> str:
    """Return the description of a field with its default, if it has one."""
    if default in (None, False, [], {}):
        return text
    value = "x".join(map(str, default)) if isinstance(default, list | tuple) else default
    return f"{text} [default: {value}]"


def arrange(
    form: dict[str, Any],
    groups: Mapping[str, Sequence[str]],
    resolve: Callable[[dict[str, Any]], dict[str, Any]],
) -> None:
    """Order the properties of a JSON schema by groups, and state defaults in descriptions only.

    Prefect's page sends all values that it shows. Defaults would override the preset, and
    ``workers`` would be a number of the machine that made the deployment.

    Args:
        groups: Names of properties by group; all others come at the end of the first.
        resolve: Returns the schema of a table from a reference to it.
    """
    fields = form["properties"]
    first, *_ = groups
    places = {key: (group, key) for group, keys in groups.items() for key in keys if key in fields}
    places |= {key: (first, key) for key in fields if key not in places}
    ranks = [*groups]
    for position, key in enumerate(sorted(places, key=lambda key: ranks.index(places[key][0]))):
        field = fields[key]
        field |= {"position": position, "title": f"{places[key][0]}: {key}"}
        tables = [part for part in (field, field.get("items", {})) if "$ref" in part]
        for part in (field, *(p for t in tables for p in resolve(t)["properties"].values())):
            default, choices = part.pop("default", None), part.get("anyOf", [])
            if "$ref" not in part:
                part["description"] = with_default(part.get("description", ""), default)
            if len(choices) == 2 and {"type": "null"} in choices:  # the server accepts null anyway
                part |= next(choice for choice in part.pop("anyOf") if choice != {"type": "null"})
