"""Find the implementation that a name stands for, importing it only then."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from slgaussian.errors import InputError, did_you_mean

PARTS = {
    "predictor": "slgaussian.predict:PREDICTORS",
    "proposer": "slgaussian.masks:PROPOSERS",
    "tracker": "slgaussian.masks:TRACKERS",
    "encoder": "slgaussian.language:ENCODERS",
    "codes": "slgaussian.language:CODES",
    "lifting": "slgaussian.semantic:LIFTINGS",
}
"""The parts of the method, each with the table of its implementations."""


def names_of(part: str) -> tuple[str, ...]:
    """The implementations that there are of one of :data:`PARTS`; none of them is imported."""
    module, table = PARTS[part].split(":")
    return tuple(getattr(import_module(module), table))


def resolve(kind: str, table: Mapping[str, str], name: str) -> Any:
    """Return the object that ``table[name]`` (``"package.module:attribute"``) points to.

    Raises
    ------
    InputError
        If ``name`` is not in the table; the message lists the names that are, and says which of
        them is nearest.
    """
    if name not in table:
        known = ", ".join(sorted(table))
        raise InputError(
            f"unknown {kind} {name!r}: expected one of {known}{did_you_mean(name, table)}"
        )
    module, attribute = table[name].split(":")
    return getattr(import_module(module), attribute)
