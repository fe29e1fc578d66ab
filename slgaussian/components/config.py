"""Base class of component configs, which declare the fields of a component once.

Command line, configuration files, JSON schema, cache identity and documentation are derived from
a config. The modules of configs must not import large packages.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import Digest


@dataclass(frozen=True)
class File:
    """Marker of a field whose value is the location of a file, folder or model.

    With the annotation ``Path`` the value is a path; with ``str | Path``, it may also be a name on
    the Hugging Face hub.

    Attributes
    ----------
    digest : callable
        Computes the SHA-256, hexadecimal, that identifies the content in artifacts and cache keys.
    """

    digest: Digest


class ComponentConfig(BaseModel):
    """Base class of configs. Class keyword ``title``: name of the component, for messages.

    Attributes
    ----------
    target : str or callable, optional
        The implementation, an object or ``"package.module:name"``, which is called with the fields
        as keyword arguments. A subclass without a target implements the component itself.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    target: ClassVar[str | Callable[..., Any] | None] = None

    def __init__(self, **values: Any) -> None:
        """Validate the values; InputError if a field is unknown or a value is invalid."""
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(_sentence(error, type(self))) from None

    @classmethod
    def files(cls) -> dict[str, File]:
        """Return the markers of the fields that are files, folders or models, by name."""
        return {
            name: marker
            for name, field in cls.model_fields.items()
            for marker in field.metadata
            if isinstance(marker, File)
        }

    @classmethod
    def takes_name(cls, field: str) -> bool:
        """Return whether a field for a file also accepts a name on the Hugging Face hub."""
        return str in get_args(cls.model_fields[field].annotation)

    @classmethod
    def implementation(cls) -> Any:
        """Import and return the class or function of the component."""
        target = cls.target or cls
        return pkgutil.resolve_name(target) if isinstance(target, str) else target

    def load(self) -> Any:
        """Load the component; raises as its implementation."""
        return self if self.target is None else self.implementation()(**dict(self))


def expected(config: type[ComponentConfig], name: str) -> str:
    """Describe the values that a field accepts: ``"a whole number from 1 to 3 or 'auto'"``."""
    options = _options(config, name)
    is_place = any(option.get("format") == "path" for option in options)
    words = [_words(option, "a name" if is_place else "text") for option in options]
    return " or ".join(sorted(words, key=lambda word: word == "a name"))


def _options(config: type[ComponentConfig], name: str) -> list[dict[str, Any]]:
    """Return the alternative JSON schemas of a field, without null and types of Python only."""
    schema = config.model_json_schema()["properties"][name]
    options = schema.get("anyOf", [schema])
    return [option for option in options if option.get("type") != "null" and "$ref" not in option]


def _words(schema: Mapping[str, Any], text: str) -> str:
    if "const" in schema:
        return repr(schema["const"])
    if "enum" in schema:
        return f"one of {', '.join(schema['enum'])}"
    if schema.get("format") == "path":
        return "a path"
    kinds = {"integer": "a whole number", "number": "a number", "boolean": "true or false"}
    bounds = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to",
              "exclusiveMaximum": "below"}  # fmt: skip
    limits = [f"{word} {schema[key]:g}" for key, word in bounds.items() if key in schema]
    return " ".join([kinds.get(schema.get("type", ""), text), *limits])


def _sentence(error: ValidationError, config: type[ComponentConfig]) -> str:
    # A misspelt key also causes a missing key; report the misspelt one.
    first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
    title = config.model_config.get("title") or config.__name__.lower()
    name = str(first["loc"][0]) if first["loc"] else ""
    if first["type"] == "extra_forbidden":
        fields = config.model_fields
        near = did_you_mean(name, fields) or f"; the keys are {', '.join(fields) or 'none'}"
        return f"unknown key '{title}.{name}'{near}"
    if "error" in first.get("ctx", {}):  # by a custom validator
        return f"{title} {name}: ".replace(" :", ":") + str(first["ctx"]["error"])
    if first["type"] == "missing":
        return f"{title} {name}: is missing, expected {expected(config, name)}"
    choices = [choice for option in _options(config, name) for choice in option.get("enum", ())]
    near = did_you_mean(first["input"], choices)
    return f"{title} {name}: found {first['input']!r}, expected {expected(config, name)}{near}"
