"""Registry of components by name, with lazy imports.

Built-in components are listed in tables, those of other packages are entry points.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from slgaussian.components.config import ComponentConfig
from slgaussian.errors import InputError, did_you_mean
from slgaussian.io import KnownFile, file_sha256


@dataclass(frozen=True)
class Kind:
    """A kind of component.

    Attributes:
        package: Subpackage of ``slgaussian``; its ``configs`` has the table of built-in components.
        plural: Name of the table (in capitals) and of the group of entry points.
        default: Name of the default component.
        help: Task of the component, for users.
    """

    package: str
    plural: str
    default: str
    help: str

    @property
    def table(self) -> Mapping[str, str]:
        """Built-in components: ``"package.module:attribute"`` by name."""
        return getattr(import_module(f"slgaussian.{self.package}.configs"), self.plural.upper())

    @property
    def group(self) -> str:
        """Group of entry points for components of other packages."""
        return f"slgaussian.{self.plural}"


KINDS = {
    "predictor": Kind("predict", "predictors", "planesweep", "Predicts Gaussians from photos."),
    "proposer": Kind("masks", "proposers", "regions", "Proposes object masks in a photograph."),
    "tracker": Kind("masks", "trackers", "geometric", "Tracks masks from view to view."),
    "encoder": Kind("language", "encoders", "lexicon", "Encodes regions and words as vectors."),
    "codes": Kind(
        "language",
        "codes",
        "separated",
        "Assigns ID codes to objects (grid as in the paper).",
    ),
    "lifting": Kind("semantic", "liftings", "hard", "Assigns ID codes to Gaussians."),
}
"""The kinds of components of the method, in the order in which they are used."""


def list_names(kind: str) -> tuple[str, ...]:
    """Return the names of the components of one of :data:`KINDS` without importing them."""
    return tuple({**KINDS[kind].table, **plugins(KINDS[kind].group)})


@cache
def find_config(kind: str, name: str) -> type[ComponentConfig]:
    """Return the config class of a component, which knows its kind and name.

    It is a subclass of the registered class. Another class or function than a config becomes the
    target of a config without fields.

    Raises:
        InputError: As in :func:`resolve`, or if a component of another package has the name of a
            built-in one, whose settings it would share.
    """
    group = KINDS[kind].group
    if name in plugins(group) and any(name in other.table for other in KINDS.values()):
        raise InputError(
            f"{kind} {name!r}: a component of this name is built in, and the package "
            f"{_owner(plugins(group)[name])} has one too; remove that package, or have its entry "
            "point renamed"
        )
    registered = resolve(kind, KINDS[kind].table, name, group)
    is_config = isinstance(registered, type) and issubclass(registered, ComponentConfig)
    base = registered if is_config else ComponentConfig
    content = {
        "__doc__": registered.__doc__,
        "__module__": registered.__module__,
        "__reduce__": _reduce,
        "kind": kind,
        "target": base.target or registered,
    }
    metaclass: Any = type(base)
    return metaclass(registered.__name__, (base,), content, title=name)


def _reduce(component: ComponentConfig) -> tuple[Any, ...]:
    """Reduce a config for pickle to kind and name, as its class is in no module, and its state."""
    return _make_blank, (component.kind, component.name), component.__getstate__()


def _make_blank(kind: str, name: str) -> ComponentConfig:
    config = find_config(kind, name)
    return config.__new__(config)


def configure(
    kind: str,
    component: str | ComponentConfig,
    tables: Mapping[str, Mapping[str, Any]] | None = None,
) -> ComponentConfig:
    """Return the config of a component that is given by name or by a config.

    Args:
        tables: {name: {field: value}}, optional. The fields of one that is given by name.

    Raises:
        InputError: As :func:`find_config`, or if a field is unknown or a value is invalid.
    """
    if not isinstance(component, ComponentConfig):
        return find_config(kind, component)(**(tables or {}).get(component, {}))
    config = find_config(kind, component.name)
    return component if isinstance(component, config) else config(**dict(component))


def restore(
    kind: str, identity: Mapping[str, Any], places: Mapping[str, str] | None = None
) -> ComponentConfig:
    """Return the config of a kind from the identity in an artifact or cache key, unvalidated.

    Args:
        identity: Identity of a method (:meth:`slgaussian.components.method.Method.identity`),
            or of some of its components: ``{"encoder": "clip", "clip": {"model": digest}}``.
        places: {field: place}, optional. Locations of its files. The content of a file without
            a stored digest is not checked.

    Raises:
        InputError: If the component or a field is unknown.
    """
    config, places = find_config(kind, identity[kind]), places or {}
    # Fields that were removed from the config and had no value had no effect.
    stored = identity.get(config.name, {}).items()
    fields = {key: v for key, v in stored if v is not None or key in config.model_fields}
    if unknown := {**fields, **places}.keys() - config.model_fields.keys():
        config(**dict.fromkeys(unknown))  # raises InputError
    for key in config.files():
        if places.get(key) or fields.get(key):
            fields[key] = KnownFile(str(places.get(key) or ""), fields.get(key))
    return config.model_construct(**fields)


def load_component(kind: str, name: str, values: Mapping[str, Any]) -> Any:
    """Load a component; raises as its implementation and :func:`find_config`.

    ``values`` are fields of its config, or other arguments of its implementation, such as a device.
    """
    return find_config(kind, name).implementation()(**values)


def resolve(called: str, table: Mapping[str, str], name: str, group: str | None = None) -> Any:
    """Import the object of ``table[name]`` (``"package.module:attribute"``).

    If the table has no such name, import the entry point of this name in ``group``.

    Raises:
        InputError: If the name is unknown, with the known names and the most similar one; or if an
            entry point cannot be imported.
    """
    external = {} if group is None else plugins(group)
    if name in table:
        module, attribute = table[name].split(":")
        return getattr(import_module(module), attribute)
    if name not in external:
        available = {**table, **external}
        raise InputError(
            f"unknown {called} {name!r}: expected one of {', '.join(sorted(available))}"
            f"{did_you_mean(name, available)}"
        )
    try:
        return external[name].load()
    except Exception as error:  # importing another package may raise anything
        raise InputError(
            f"{called} {name!r}: {external[name].value} of the package {_owner(external[name])} "
            f"cannot be imported ({type(error).__name__}: {error}); repair or remove that package"
        ) from error


@cache
def plugins(group: str) -> Mapping[str, EntryPoint]:
    """Return the entry points of a group by name, sorted, without importing them."""
    return {entry.name: entry for entry in sorted(_installed().select(group=group))}


_installed = cache(entry_points)  # reads a file of every package


@cache
def plugin_identity(group: str, name: str) -> str:
    """Return the identity of an entry point for cache keys, "" for a built-in object.

    It has package and SHA-256 of the Python files of the top-level module, which is not imported.
    """
    if name not in plugins(group):
        return ""
    entry, content = plugins(group)[name], hashlib.sha256()
    spec = find_spec(entry.module.partition(".")[0])
    if spec is not None:
        folders = map(Path, spec.submodule_search_locations or ())
        files = sorted(file for folder in folders for file in folder.rglob("*.py"))
        for file in files or [Path(spec.origin or "")]:
            content.update(f"{file.name} {file_sha256(file)}\n".encode())
    return f"{_owner(entry)} {content.hexdigest()}"


def _owner(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.module


def list_components() -> str:
    """Return all components with their fields, or their import error, as Markdown."""
    text = []
    for kind, group in KINDS.items():
        text.append(f"## {kind.capitalize()}\n\n{group.help}")
        for name in list_names(kind):
            text.append(f"### {name}{' (default)' if name == group.default else ''}")
            try:
                text += find_config(kind, name).describe()
            except InputError as error:
                text.append(str(error))
    return "\n\n".join(text) + "\n"
