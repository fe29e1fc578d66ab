"""Find the implementation that a name stands for, importing it only then."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from slgaussian.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Kind:
    """A kind of part.

    Attributes
    ----------
    table : str
        ``"package.module:NAME"`` of the table of its built-in parts.
    called : str
        In sentences.
    default : str
        The part that is taken if none is named.
    help : str
        What such a part does, for users.
    """

    table: str
    called: str
    default: str
    help: str


KINDS = {
    "predictor": Kind(
        "slgaussian.predict:PREDICTORS",
        "predictor",
        "planesweep",
        "What makes Gaussians of photographs.",
    ),
    "proposer": Kind(
        "slgaussian.masks:PROPOSERS",
        "mask proposer",
        "regions",
        "What finds object masks in a photograph.",
    ),
    "tracker": Kind(
        "slgaussian.masks:TRACKERS",
        "mask tracker",
        "geometric",
        "What carries masks from view to view.",
    ),
    "encoder": Kind(
        "slgaussian.language:ENCODERS",
        "encoder",
        "lexicon",
        "What turns regions and words into vectors.",
    ),
    "codes": Kind(
        "slgaussian.language:CODES",
        "code strategy",
        "separated",
        "How objects get ID codes (grid as in the paper, exact without any).",
    ),
    "lifting": Kind(
        "slgaussian.semantic:LIFTINGS",
        "lifting",
        "hard",
        "What gives Gaussians their ID codes.",
    ),
}
"""The kinds of parts of the method, in the order in which they work."""

PARTS = {kind: known.table for kind, known in KINDS.items()}
"""The parts of the method, each with the table of its implementations."""


def names_of(part: str) -> tuple[str, ...]:
    """The implementations that there are of one of :data:`PARTS`; none of them is imported."""
    return tuple(_table(part))


def find_part(kind: str, name: str) -> Any:
    """The class of the part of a kind and name.

    Raises
    ------
    InputError
        As :func:`resolve`.
    """
    return resolve(KINDS[kind].called, _table(kind), name)


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


def _table(kind: str) -> Mapping[str, str]:
    module, table = KINDS[kind].table.split(":")
    return getattr(import_module(module), table)
