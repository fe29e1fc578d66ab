"""Reading and validation of configurations from a TOML file or the command line."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from flows.config import TABLES, MethodSettings, Settings
from flows.forms import merge_tables
from slgaussian.components.registry import KINDS
from slgaussian.errors import InputError
from slgaussian.storage.remote import check_url

AnyModel = TypeVar("AnyModel", bound=BaseModel)

PATHS = ("out", "data", "pairs", "labels", "models", "withdrawn")
"""Settings that are paths."""

URLS = ("store", "sources")
"""Settings that may be URLs, one or several."""


def validate_settings(model: type[AnyModel], values: dict[str, Any], source: str) -> AnyModel:
    """Return ``model(**values)``; InputError, which names source and key."""
    for name in URLS:
        for url in [values[name]] if isinstance(values.get(name), str) else values.get(name) or ():
            check_url(str(url), f"{source}: {name}")
    try:
        config = model(**values)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    if isinstance(config, MethodSettings):
        config.components  # noqa: B018  (InputError for an unknown name)
    return config


def make_settings(values: dict[str, Any], source: str, model: Any = Settings) -> Any:
    """Validate ``values`` as :func:`read_toml` does those of ``overrides``."""
    return read_toml(None, values, model, source)


def read_toml(
    path: Path | None, overrides: dict[str, Any], model: Any = Settings, command: str = "run"
) -> Any:
    """Read a configuration file of a command, if any; ``overrides`` take precedence.

    The file may have tables of unused components, so that components are easily exchanged.

    Raises:
        InputError: If the file cannot be read, a key is unknown or a value is invalid.
    """
    values = overrides if path is None else read_values(path, overrides)
    settings = validate_settings(model, values, command if path is None else str(path))
    refuse_idle(overrides, settings, command)
    return settings


def read_values(path: Path, overrides: dict[str, Any]) -> dict[str, Any]:
    """Read the values of a TOML file, merged with ``overrides`` by :func:`merge_tables`.

    Relative paths in the file are relative to its folder, those of ``overrides`` are not.

    Raises:
        InputError: If the file cannot be read.
    """
    try:
        values = tomllib.loads(path.read_text("utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the configuration ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not valid TOML ({error})") from error
    return merge_tables(resolve_paths(values, path.resolve().parent), overrides)


def resolve_paths(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a copy of settings with relative paths resolved against ``folder``."""
    values = _resolve_paths(values, PATHS, folder)
    if isinstance(values.get("store"), str) and "://" not in values["store"]:
        values["store"] = str(folder / values["store"])
    if isinstance(values.get("sources"), list):
        values["sources"] = [_resolve_source(str(source), folder) for source in values["sources"]]
    if isinstance(values.get("scenes"), list):
        values["scenes"] = [_resolve_paths(s, ("path", "labels"), folder) for s in values["scenes"]]
    for name in TABLES.keys() & values.keys():
        if isinstance(table := values[name], dict):
            places = [
                key
                for key in TABLES[name].files()
                if not TABLES[name].takes_name(key) or (folder / str(table.get(key))).exists()
            ]
            values[name] = _resolve_paths(table, places, folder)
    return values


def _resolve_source(source: str, folder: Path) -> str:
    """Resolve the path in SOURCE or PLACE=SOURCE; URLs and procedural rooms stay as they are."""
    place, equals, location = source.partition("=")
    if not equals or (folder / source).exists():
        place, equals, location = "", "", source
    is_path = ":" not in location.partition("/")[0]
    return f"{place}{equals}{folder / location}" if is_path else source


def _resolve_paths(table: Any, keys: Sequence[str], folder: Path) -> Any:
    if not isinstance(table, dict):
        return table  # validation reports the error
    places = {key: table[key] for key in keys if isinstance(table.get(key), str | Path)}
    return {**table, **{key: str(folder / place) for key, place in places.items()}}


def refuse_idle(values: dict[str, Any], settings: MethodSettings, source: str) -> None:
    """Raise InputError if ``values`` has the table of a component that is not used."""
    used = {component.table for component in settings.components}
    for name in (name for name in TABLES if name in values and name not in used):
        chosen = ", ".join(f"{kind} {getattr(settings, kind)!r}" for kind in KINDS)
        raise InputError(
            f"{source}: settings of {name!r} are given, but no component is {name!r} (found "
            f"{chosen}); choose it, or leave them out"
        )
