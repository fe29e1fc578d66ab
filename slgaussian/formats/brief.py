"""How the library's objects print: names, types and shapes, and never the numbers of an array."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

FEW = 4
"""Entries of a collection that are printed; of more, how many there are."""


def brief(self: Any) -> str:
    """The ``repr`` of a dataclass that holds arrays; fields that are None by default are left out.

    >>> import numpy as np
    >>> from slgaussian.labels import LabelMaps
    >>> LabelMaps(np.zeros((2, 3, 4), np.int32), np.zeros((2, 3, 4), np.float32))
    LabelMaps(labels=int32 [2, 3, 4], margin=float32 [2, 3, 4])
    """
    own = ((f, getattr(self, f.name)) for f in fields(self) if f.repr)
    shown = [f"{f.name}={said(value)}" for f, value in own if value is not None or f.default]
    return f"{type(self).__name__}({', '.join(shown)})"


def said(value: Any) -> str:
    """A value of a field in a few words."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"
    if isinstance(value, Mapping):
        plain = all(isinstance(one, (str, int, float)) for one in value.values())
        entries = (f"{key!r}: {one!r}" if plain else repr(key) for key, one in value.items())
        return f"{{{_listed(entries, len(value))}}}"
    if isinstance(value, (tuple, list)):
        named = (repr(getattr(one, "name", one)) for one in value)
        return f"({_listed(named, len(value))})"
    return value.__qualname__ if hasattr(value, "__qualname__") else repr(value)


def _listed(texts: Iterable[str], count: int) -> str:
    shown = [text for text, _ in zip(texts, range(FEW), strict=False)]
    return ", ".join([*shown, f"and {count - FEW} more"] if count > FEW else shown)
