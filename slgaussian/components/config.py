"""Base classes of configs, which declare the fields of settings and components once.

Command line, configuration files, JSON schema, cache identity and documentation are derived from
a config. The modules of configs must not import large packages.
"""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import CHANGED_FILE, Digest, KnownFile


@dataclass(frozen=True)
class File:
    """Marker of a field whose value is the location of a file, folder or model.

    With the annotation ``Path`` the value is a path; with ``str | Path``, it may also be a name on
    the Hugging Face hub.

    Attributes:
        digest: callable. Computes the SHA-256, hexadecimal, that identifies the content in
            artifacts and cache keys.
    """

    digest: Digest


class Config(BaseModel):
    """Base class of immutable, validated settings."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    def __init__(self, **values: Any) -> None:
        """Validate the values; InputError if a field is unknown or a value is invalid."""
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(explain(error, type(self))) from None

    @classmethod
    def of(cls, settings: BaseModel) -> Self:
        """Return the fields of this class out of settings that inherit them."""
        return cls(**{name: getattr(settings, name) for name in cls.model_fields})


class ComponentConfig(Config):
    """Base class of component configs: the fields that users set; loads the component.

    Class keyword ``title``: the name, by default that of the class in lower case. Fields for files
    are locations, or :class:`slgaussian.io.KnownFile` after :meth:`pin`.

    Attributes:
        kind: One of :data:`slgaussian.components.registry.KINDS`; empty for a class that was not
            found there.
        name: Name of the component.
        table: Name of the table of its fields in configurations: the name without hyphens.
        target: str or callable, optional. The implementation, an object or
            ``"package.module:name"``, which is called with the fields as keyword arguments. A
            subclass without a target implements the component itself.
    """

    kind: ClassVar[str] = ""
    name: ClassVar[str] = ""
    table: ClassVar[str] = ""
    target: ClassVar[str | Callable[..., Any] | None] = None

    @classmethod
    def __pydantic_init_subclass__(cls, **keywords: Any) -> None:
        """Name the component."""
        cls.name = cls.model_config.get("title") or cls.__name__.lower()
        cls.table = cls.name.replace("-", "_")

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

    @classmethod
    def describe(cls) -> list[str]:
        """Return the first sentence of the docstring, and a list of the fields, as Markdown."""
        text = re.sub(r":\w+:`[~\w.]*?(\w+)`", r"\1", inspect.getdoc(cls) or "")
        sentence = text.partition("\n\n")[0].replace("\n", " ").replace("``", "`").split(". ")[0]
        fields = []
        for name, field in cls.model_fields.items():
            default = "" if field.default is None else f"; default `{field.default}`"
            fields.append(f"- `{name}`: {describe_values(cls, name)}{default}. {field.description}")
        return [f"{sentence.rstrip('.')}.", *(["\n".join(fields)] if fields else [])]

    def pin(self) -> Self:
        """Return the config with the current digests of its files, which :meth:`load` then checks.

        Raises:
            InputError: If a file cannot be read.
        """
        known = {}
        for key, file in self.files().items():
            place = getattr(self, key)
            if place is None or isinstance(place, KnownFile):
                continue
            try:
                known[key] = KnownFile.at(place, file.digest)
            except (OSError, InputError) as error:
                self.load()  # its error message is more specific
                raise InputError(f"{self.name} {key} {place}: {error}") from error
        return self.model_copy(update=known) if known else self

    @property
    def known_files(self) -> dict[str, KnownFile]:
        """The files, folders and models among its fields, after :meth:`pin`."""
        return {key: value for key, value in self if isinstance(value, KnownFile)}

    def identity(self) -> dict[str, Any]:
        """Return the fields for artifacts and cache keys: plain data, files by digest.

        Raises:
            InputError: As :meth:`pin`.
        """
        pinned = self.pin()
        return {**dict(pinned), **{key: file.digest for key, file in pinned.known_files.items()}}

    def places(self) -> dict[str, str]:
        """Return the locations of its files, by field; raises as :meth:`pin`."""
        return {key: file.place for key, file in self.pin().known_files.items() if file.place}

    def values(self, otherwise: str = CHANGED_FILE) -> dict[str, Any]:
        """Return the fields, with files as places; InputError as in :meth:`load`."""
        marks, files = self.files(), self.known_files
        places = {k: file.checked(k, marks[k].digest, otherwise) for k, file in files.items()}
        return {**dict(self), **places}

    def load(self, otherwise: str = CHANGED_FILE) -> Any:
        """Load the component; one that implements itself and is loaded already returns itself.

        Raises:
            InputError: If the content of a pinned file has changed, with message ``otherwise``; or
                by the component.
        """
        target, values = self.implementation(), self.values(otherwise)
        return self if type(self) is target and values == dict(self) else target(**values)


def describe_values(config: type[BaseModel], name: str) -> str:
    """Describe the values that a field accepts: ``"a whole number from 1 to 3 or 'auto'"``."""
    options = _options(config, name)
    is_place = any(option.get("format") == "path" for option in options)
    words = [_words(option, "a name" if is_place else "text") for option in options]
    return " or ".join(sorted(dict.fromkeys(words), key=lambda word: word == "a name"))


def _options(config: type[BaseModel], name: str) -> list[dict[str, Any]]:
    """Return the alternative JSON schemas of a field, without null."""
    schema = config.model_json_schema()["properties"][name]
    options = schema.get("anyOf", [schema])
    return [option for option in options if option.get("type") != "null"]


def _words(schema: Mapping[str, Any], text: str) -> str:
    if "const" in schema:
        return repr(schema["const"])
    if "enum" in schema:
        return f"one of {', '.join(schema['enum'])}"
    if schema.get("format") == "path":
        return "a path"
    if "$ref" in schema:
        return "a table"
    kinds = {"integer": "a whole number", "number": "a number", "boolean": "true or false",
             "array": "a list", "object": "a table"}  # fmt: skip
    bounds = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to",
              "exclusiveMaximum": "below", "minItems": "of at least",
              "minLength": "of at least"}  # fmt: skip
    limits = [f"{word} {schema[key]:g}" for key, word in bounds.items() if key in schema]
    return " ".join([kinds.get(schema.get("type", ""), text), *limits])


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Describe the first error of a validation: the key, the value found, and what is expected."""
    # A misspelt key also causes a missing key; report the misspelt one.
    first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
    is_config = issubclass(model, Config)
    title = model.model_config.get("title") or ""
    if issubclass(model, ComponentConfig):
        title = model.name
    loc = list(first["loc"])
    if is_config:  # texts after the first part are names of the members of a union
        loc = loc[:1] + [part for part in loc[1:] if isinstance(part, int)]
    key = ".".join(map(str, loc))
    if first["type"] == "extra_forbidden":
        fields = model.model_fields
        near = did_you_mean(key, fields) or f"; the keys are {', '.join(fields) or 'none'}"
        return f"unknown key '{f'{title}.{key}'.lstrip('.')}'{near}"
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):  # by a config in a field, which names its own field
        return str(cause) if len(loc) < 2 else f"{key}: {cause}"
    if cause and not loc:  # by a validator of the whole model
        return f"{title}: {cause}" if title else str(cause)
    place = f"{title} {key}".strip() or "content"
    if first["type"] == "missing":
        return f"{place} is missing"
    value = f"{place}: found {first['input']!r:.60}"
    if cause or not is_config or len(loc) > 1:
        message = str(cause or first["msg"])
        return f"{value}; {message[0].lower()}{message[1:]}"
    choices = [choice for option in _options(model, key) for choice in option.get("enum", ())]
    return f"{value}, expected {describe_values(model, key)}{did_you_mean(first['input'], choices)}"
