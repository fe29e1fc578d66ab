"""Settings of a part, declared once: as fields of the part's own dataclass.

A field made by :func:`setting` is what users may set. Command line, configuration files, cache
identity and documentation are made from these declarations; a field made otherwise is for code.
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

from slgaussian.errors import InputError, did_you_mean

Content = Callable[[str | Path], str]
"""What the content at a place is known by: a digest, hexadecimal."""

SETTING = "setting"
"""Key of a declaration in the metadata of a dataclass field."""


@dataclass(frozen=True)
class Setting:
    """What a part declares about one of its settings.

    Attributes
    ----------
    name : str
        Of the field.
    type : type
        Of the field, as annotated: ``int``, ``float``, ``str``, ``bool``, ``Path``, each also with
        ``None`` or a literal such as ``"auto"``.
    default : object
    help : str
        One sentence for users.
    low, high : number, optional
        Least and greatest value of a number.
    choices : tuple of str
        All values that there are.
    expected : str, optional
        What a value must be, in words, where bounds and choices do not say it well.
    content : callable, optional
        Of a file, folder or model: what it is known by in artifacts and cache keys, in place of
        where it is. Annotated as a ``Path`` the value is a path; as a ``str``, it may also be a
        name, as on the Hugging Face hub.
    optional : bool
        Of a file: whether the part works without it.
    """

    name: str
    type: Any
    default: Any
    help: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    expected: str | None = None
    content: Content | None = None
    optional: bool = False

    @property
    def members(self) -> tuple[Any, ...]:
        """The types that a value may have, and ``None`` or literals as such."""
        union = typing.get_origin(self.type) in (typing.Union, types.UnionType)
        found = typing.get_args(self.type) if union else (self.type,)
        listed = (
            typing.get_args(member) if typing.get_origin(member) is typing.Literal else (member,)
            for member in found
        )
        return tuple(member for members in listed for member in members)

    @property
    def words(self) -> tuple[str, ...]:
        """Words that stand for a value, such as ``"auto"`` for a number."""
        return tuple(member for member in self.members if isinstance(member, str))

    @property
    def is_path(self) -> bool:
        """Whether a value is a path, and never a name."""
        return Path in self.members and str not in self.members

    def wanted(self) -> str:
        """What a value must be, as sentences about another one say it."""
        if self.expected is not None:
            return self.expected
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.low is not None and self.high is not None:
            said = f"{self.low} to {self.high}"
        else:
            said = f"at least {self.low}" if self.high is None else f"at most {self.high}"
        return "".join([said, *(f' or "{word}"' for word in self.words)])

    def fits(self, value: Any) -> bool:
        """Whether a value is within the bounds and among the choices, if there are any."""
        if value is None:
            return True
        if self.choices and (isinstance(value, str) or type(value) not in self.members):
            return value in self.choices
        low, high = self.low, self.high
        if (low is None and high is None) or value in self.words:
            return True
        if not isinstance(value, Real) or (float not in self.members and value % 1 != 0):
            return False
        number: Any = value  # Real is a class of numbers that compare, which its hints do not say
        return (low is None or number >= low) and (high is None or number <= high)


def setting(
    default: Any,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    expected: str | None = None,
    content: Content | None = None,
    optional: bool = False,
) -> Any:
    """A field of a part's dataclass that users may set; see :class:`Setting`."""
    declared = {
        "help": help,
        "low": low,
        "high": high,
        "choices": choices,
        "expected": expected,
        "content": content,
        "optional": optional,
    }
    return dataclasses.field(default=default, metadata={SETTING: declared})


def settings_of(part: Any) -> dict[str, Setting]:
    """The declared settings of a part's class by name, in their order; none of other things."""
    if not (isinstance(part, type) and dataclasses.is_dataclass(part)):
        return {}
    return {
        field.name: Setting(
            field.name, _annotation(part, field), field.default, **field.metadata[SETTING]
        )
        for field in dataclasses.fields(part)
        if SETTING in field.metadata
    }


def check_settings(part: Any, label: str) -> None:
    """Hold the settings of a part against their declarations; for ``__post_init__``.

    Raises
    ------
    InputError
        If a value does not fit; the sentence begins with ``label`` and the setting's name.
    """
    for name, declared in settings_of(type(part)).items():
        value = getattr(part, name)
        if not declared.fits(value):
            near = did_you_mean(value, declared.choices)
            raise InputError(f"{label} {name}: found {value!r}, expected {declared.wanted()}{near}")


def _annotation(part: type, field: dataclasses.Field[Any]) -> Any:
    """The type of a field; others of the same class may name what only a type checker imports."""
    if not isinstance(field.type, str):
        return field.type
    owner = next(c for c in part.__mro__ if field.name in inspect.get_annotations(c))
    alone = types.SimpleNamespace(__annotations__={field.name: field.type})
    return typing.get_type_hints(alone, vars(sys.modules[owner.__module__]))[field.name]
