"""Find the implementation that a name stands for, importing it only then.

Those of this package stand in tables, those of others are their entry points.
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
from typing import Any, ClassVar

from slgaussian.components.config import ComponentConfig
from slgaussian.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Kind:
    """A kind of component.

    Attributes
    ----------
    package : str
        The package of ``slgaussian`` whose table has the built-in ones.
    plural : str
        What the table (in capitals) and the entry points of other packages are called.
    default : str
        The component that is taken if none is named.
    help : str
        What such a component does, for users.
    """

    package: str
    plural: str
    default: str
    help: str

    @property
    def table(self) -> Mapping[str, str]:
        """The built-in components: ``"package.module:attribute"`` by name."""
        return getattr(import_module(f"slgaussian.{self.package}"), self.plural.upper())

    @property
    def group(self) -> str:
        """The group of entry points by which other packages bring such components."""
        return f"slgaussian.{self.plural}"


KINDS = {
    "predictor": Kind(
        "predict", "predictors", "planesweep", "What makes Gaussians of photographs."
    ),
    "proposer": Kind("masks", "proposers", "regions", "What finds object masks in a photograph."),
    "tracker": Kind("masks", "trackers", "geometric", "What carries masks from view to view."),
    "encoder": Kind(
        "language", "encoders", "lexicon", "What turns regions and words into vectors."
    ),
    "codes": Kind(
        "language",
        "codes",
        "separated",
        "How objects get ID codes (grid as in the paper, exact without any).",
    ),
    "lifting": Kind("semantic", "liftings", "hard", "What gives Gaussians their ID codes."),
}
"""The kinds of components of the method, in the order in which they work."""


def names_of(kind: str) -> tuple[str, ...]:
    """Return the names of the components of one of :data:`KINDS`; none of them is imported."""
    return tuple({**KINDS[kind].table, **brought(KINDS[kind].group)})


def find_config(kind: str, name: str) -> type[ComponentConfig]:
    """Return the config class of the component of a kind and name.

    What is registered and is none, a class or function, becomes the target of one without fields.

    Raises
    ------
    InputError
        As :func:`resolve`, or if a component of another package has the name of a built-in one.
    """
    group = KINDS[kind].group
    for built_in in KINDS if name in brought(group) else ():
        if name in KINDS[built_in].table:
            raise InputError(
                f"{kind} {name!r}: the package {_owner(brought(group)[name])} brings one, but a "
                f"{built_in} of this name is built in; remove that package, or have its entry "
                "point renamed"
            )
    registered = resolve(kind, KINDS[kind].table, name, group)
    if isinstance(registered, type) and issubclass(registered, ComponentConfig):
        return registered

    class Plain(ComponentConfig, title=name):
        __doc__ = registered.__doc__
        target: ClassVar[Any] = registered

    return Plain


def load_component(kind: str, name: str, values: Mapping[str, Any]) -> Any:
    """Return the component of a kind and name with these values; raises as it and `find_config`.

    Values are fields of its config, or what its implementation takes besides, such as a device.
    """
    return find_config(kind, name).implementation()(**values)


def resolve(called: str, table: Mapping[str, str], name: str, group: str | None = None) -> Any:
    """Return the object that ``table[name]`` (``"package.module:attribute"``) points to.

    Or else that of this name among the entry points of ``group``, if one is given.

    Raises
    ------
    InputError
        If there is none: the message lists the names that are, and says which of them is nearest.
        If an entry point cannot be imported.
    """
    external = {} if group is None else brought(group)
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
    except Exception as error:  # whatever another package does when it is imported
        raise InputError(
            f"{called} {name!r}: {external[name].value} of the package {_owner(external[name])} "
            f"cannot be imported ({type(error).__name__}: {error}); repair or remove that package"
        ) from error


@cache
def brought(group: str) -> Mapping[str, EntryPoint]:
    """Return the entry points of a group by name, in alphabetical order; nothing is imported."""
    return {entry.name: entry for entry in sorted(_installed().select(group=group))}


_installed = cache(entry_points)  # it reads a file of every package


@cache
def known_by(group: str, name: str) -> str:
    """Return what identifies an object that another package brings, "" for any other.

    Package, version and the SHA-256 of its Python files, since code changes more often than
    versions do. The files are those of the package or module that the entry point begins with;
    nothing of it is imported.
    """
    if name not in brought(group):
        return ""
    entry = brought(group)[name]
    try:
        spec = find_spec(entry.module.partition(".")[0])
    except (ImportError, ValueError):  # which importing it says better
        spec = None
    folders = [] if spec is None else [Path(p) for p in spec.submodule_search_locations or ()]
    files = [(file.relative_to(top), file) for top in folders for file in top.rglob("*.py")]
    if spec is not None and not folders and spec.origin is not None:
        files = [(Path(Path(spec.origin).name), Path(spec.origin))]
    content = hashlib.sha256()
    for place, file in sorted((str(place), file) for place, file in files):
        for part in (place.encode("utf-8", "surrogateescape"), file.read_bytes()):
            content.update(len(part).to_bytes(8, "little") + part)
    version = entry.dist.version if entry.dist is not None else "?"
    return f"{_owner(entry)} {version} {content.hexdigest()}"


def _owner(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else entry.module
