"""Presets, types of fields that may be text, and the base class of configurations with both."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PositiveInt,
    StringConstraints,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema

from slgaussian.components.config import Config
from slgaussian.errors import did_you_mean

PRESETS = ("fast", "balanced", "paper")
"""Named settings, each a file in `presets`. The last has the settings of the paper, see
`docs/reference/paper.md`."""

ALLOWED_SIDES = range(16, 8193)
"""Allowed heights and widths of views, in pixels."""

AT_MOST_PREFIX = "at most "

RUNNERS = ("threads", "processes")
"""Runners on this machine."""

PORTS = {"dask": 8786, "ray": 10001}
"""Usual port of a running cluster."""

_RUNNER_PATTERN = f"{'|'.join(RUNNERS)}|({'|'.join(PORTS)})://.+:[0-9]+"


def _parse_sides(value: Any, texts: str = "") -> tuple[int, int]:
    """Parse height and width from ``"256x256"``, as on the command line, or from a pair."""
    try:
        height, width = map(int, value.split("x") if isinstance(value, str) else value)
    except (TypeError, ValueError):
        height = width = 0
    if height not in ALLOWED_SIDES or width not in ALLOWED_SIDES:
        raise ValueError(
            f"expected height and width as in 256x256, each from {ALLOWED_SIDES[0]} to "
            f"{ALLOWED_SIDES[-1]}{texts}"
        )
    return height, width


def _parse_size(value: Any) -> tuple[int, int] | str:
    """Parse height and width, or one of the texts for sizes."""
    if value in ("auto", "original"):
        return value
    bound = isinstance(value, str) and value.startswith(AT_MOST_PREFIX)
    sides = value.removeprefix(AT_MOST_PREFIX) if bound else value
    height, width = _parse_sides(sides, ", 'at most 416x576', 'auto' or 'original'")
    return f"{AT_MOST_PREFIX}{height}x{width}" if bound else (height, width)


def _parse_runner(value: Any) -> str:
    text = str(value)
    if re.fullmatch(_RUNNER_PATTERN, text):
        return text
    kind = text.partition("://")[0]
    advice = did_you_mean(kind, (*RUNNERS, *PORTS))
    if kind in PORTS:
        advice = f"; give the address of the running cluster, as {kind}://host:{PORTS[kind]}"
    raise ValueError(
        "expected threads, processes, or for a cluster that runs dask://host:port or "
        f"ray://host:port{advice}"
    )


def _schema(pattern: str, *lists: dict[str, Any]) -> WithJsonSchema:
    return WithJsonSchema({"anyOf": [{"type": "string", "pattern": f"^({pattern})$"}, *lists]})


_NUMBERS = {"type": "array", "minItems": 1, "items": {"type": "integer", "minimum": 1}}
_PAIR = {**_NUMBERS, "minItems": 2, "maxItems": 2}

Sides = Annotated[tuple[int, int], BeforeValidator(_parse_sides), _schema("[0-9]+x[0-9]+", _PAIR)]
Size = Annotated[
    tuple[int, int] | str,
    BeforeValidator(_parse_size),
    _schema(f"auto|original|({AT_MOST_PREFIX})?[0-9]+x[0-9]+", _PAIR),
]
Runner = Annotated[str, BeforeValidator(_parse_runner), _schema(_RUNNER_PATTERN)]
Phrase = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
Widths = Annotated[
    tuple[PositiveInt, ...],
    BeforeValidator(lambda value: value.split(",") if isinstance(value, str) else value),
    Field(min_length=1),
    _schema("[1-9][0-9]*(,[1-9][0-9]*)*", _NUMBERS),
]
"""Numbers of channels: a list, or text as in 8,16,24,32."""


def with_default(text: str, default: Any) -> str:
    """Return the description of a field with its default, if it has one."""
    if default in (None, False, [], ()):
        return text
    value = "x".join(map(str, default)) if isinstance(default, list | tuple) else default
    return f"{text} [default: {value}]"


def merge_tables(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return ``under`` updated by ``over``; tables are merged key by key."""
    tables = [name for name in under if isinstance(under[name], dict)]
    both = {n: {**under[n], **over[n]} for n in tables if isinstance(over.get(n), dict)}
    return {**under, **over, **both}


def preset_values(name: Any, prefix: str = "") -> dict[str, Any]:
    """Return the settings of a preset; none if there is no such preset."""
    file = Path(__file__).parent / "presets" / f"{prefix}{name}.toml"
    return tomllib.loads(file.read_text("utf-8")) if name in PRESETS and file.is_file() else {}


class Form(Config):
    """Base class of the configurations of flows, given by files, commands or Prefect's page."""

    titles: ClassVar[dict[str, str]] = {}  # of fields, in the order of the page
    preset_prefix: ClassVar[str] = ""

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, values: Any) -> Any:
        """Add the settings of the preset; null stands for the default."""
        if isinstance(values, cls):
            return values
        given = {key: value for key, value in values.items() if value is not None}
        return merge_tables(preset_values(given.get("preset"), cls.preset_prefix), given)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Order the fields, and state defaults in descriptions only.

        Prefect's page sends all values that it shows. Defaults would override the preset, and
        ``workers`` would be a number of the machine that made the deployment.
        """
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema)["properties"]
        order = [*cls.titles, *properties]
        for key, field in properties.items():
            field |= {"position": order.index(key), "title": cls.titles.get(key, key)}
            tables = [part for part in (field, field.get("items", {})) if "$ref" in part]
            inner = [handler.resolve_ref_schema(table)["properties"] for table in tables]
            for part in (field, *(part for table in inner for part in table.values())):
                default = part.pop("default", None)
                if "$ref" not in part:
                    part["description"] = with_default(part.get("description", ""), default)
                choices = [one for one in part.get("anyOf", ()) if one != {"type": "null"}]
                if len(choices) == 1:  # the server takes null for any field that is not required
                    del part["anyOf"]
                    part |= choices[0]
        return schema
