"""Find the implementation that a name stands for, importing it only then."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from slgaussian.errors import InputError


def resolve(kind: str, table: Mapping[str, str], name: str) -> Any:
    """Return the object that ``table[name]`` (``"package.module:attribute"``) points to.

    Raises
    ------
    InputError
        If ``name`` is not in the table; the message lists the names that are.
    """
    if name not in table:
        known = ", ".join(sorted(table))
        raise InputError(f"unknown {kind} {name!r}: expected one of {known}")
    module, attribute = table[name].split(":")
    return getattr(import_module(module), attribute)
