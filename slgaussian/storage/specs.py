"""What the data look like: one ``.toml`` file a spec, read by one validator.

A spec of kind ``arrays`` lists named arrays with dtype and shape; the letters of a shape are sizes
that must agree within one artifact. A spec of kind ``table`` lists columns. Both are checked when
an artifact is written and again when it is read.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
import pyarrow as pa

from slgaussian.errors import SpecError

COLUMN_TYPES = {
    "string": pa.string(),
    "int64": pa.int64(),
    "float64": pa.float64(),
    "bool": pa.bool_(),
    "float64 list": pa.list_(pa.float64()),
    "string list": pa.list_(pa.string()),
}


@dataclass(frozen=True)
class Field:
    """One array of an artifact.

    ``shape`` mixes numbers and letters; ``low`` and ``high`` are inclusive bounds of the values.
    Floats are finite. ``dtype`` is a NumPy name, or ``str`` for text of any length.
    """

    dtype: str
    shape: tuple[int | str, ...]
    doc: str
    optional: bool = False
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Column:
    """One column of a table; a column that is not ``nullable`` has a value in every row."""

    type: str
    doc: str
    nullable: bool = False


@dataclass(frozen=True)
class Spec:
    """What one kind of artifact holds: ``fields`` of an ``.npz`` or ``columns`` of a table."""

    name: str
    doc: str
    compress: bool
    fields: Mapping[str, Field]
    columns: Mapping[str, Column]

    @property
    def suffix(self) -> str:
        """File name ending of the artifact."""
        return ".parquet" if self.columns else ".npz"

    @property
    def schema(self) -> pa.Schema:
        """The Arrow schema of a table spec."""
        columns = self.columns.items()
        return pa.schema([pa.field(n, COLUMN_TYPES[c.type], c.nullable) for n, c in columns])

    def check_arrays(self, arrays: Mapping[str, np.ndarray], file: str) -> None:
        """Raise :class:`SpecError` at the first array that is not what this spec says."""
        unknown = sorted(set(arrays) - set(self.fields))
        if unknown:
            raise mismatch(file, unknown[0], "an unknown field", f"only {', '.join(self.fields)}")
        sizes: dict[str, tuple[int, str]] = {}
        for name, field in self.fields.items():
            if name in arrays:
                _check_array(arrays[name], field, name, file, sizes)
            elif not field.optional:
                raise mismatch(file, name, "no such field", _describe(field))

    def check_table(self, table: pa.Table, file: str) -> None:
        """Raise :class:`SpecError` at the first column that is not what this spec says."""
        for name, column in self.columns.items():
            if name not in table.column_names:
                raise mismatch(file, name, "no such column", f"a {column.type} column")
            data = table.column(name)
            if data.type != COLUMN_TYPES[column.type]:
                raise mismatch(file, name, f"{data.type}", f"{COLUMN_TYPES[column.type]}")
            if data.null_count and not column.nullable:
                raise mismatch(file, name, f"{data.null_count} empty cells", "a value in each row")
        unknown = [name for name in table.column_names if name not in self.columns]
        if unknown:
            raise mismatch(file, unknown[0], "an unknown column", f"only {list(self.columns)}")


@cache
def load_spec(name: str) -> Spec:
    """The spec called ``name``.

    Raises
    ------
    SpecError
        If there is no such spec; the message lists those there are.
    """
    if name not in spec_names():
        raise SpecError(f"no data spec {name!r}: expected one of {', '.join(spec_names())}")
    raw = tomllib.loads((files("data_specs") / f"{name}.toml").read_text("utf-8"))
    fields = {
        n: Field(**{**table, "shape": tuple(table["shape"])})
        for n, table in raw.pop("fields", {}).items()
    }
    columns = {n: Column(**table) for n, table in raw.pop("columns", {}).items()}
    return Spec(name=name, fields=fields, columns=columns, **{"compress": True, **raw})


@cache
def spec_names() -> tuple[str, ...]:
    """The names of all specs, sorted."""
    names = (entry.name for entry in files("data_specs").iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def mismatch(file: str, field: str, found: str, expected: str) -> SpecError:
    """The one form of a :class:`SpecError` about a file."""
    return SpecError(f"{file}: {field}: found {found}, expected {expected}")


def _describe(field: Field) -> str:
    return f"{field.dtype} [{', '.join(map(str, field.shape))}]"


def _check_array(
    array: np.ndarray, field: Field, name: str, file: str, sizes: dict[str, tuple[int, str]]
) -> None:
    found = f"{array.dtype} {list(array.shape)}"
    dtype_fits = array.dtype.kind == "U" if field.dtype == "str" else array.dtype == field.dtype
    if not dtype_fits or array.ndim != len(field.shape):
        raise mismatch(file, name, found, _describe(field))
    for size, expected in zip(array.shape, _resolve(field.shape, array.shape, sizes), strict=True):
        if size != expected[0]:
            raise mismatch(file, name, found, f"{_describe(field)} with {expected[1]}")
    for letter, size in zip(field.shape, array.shape, strict=True):
        if isinstance(letter, str):
            sizes.setdefault(letter, (size, f"{letter} = {size} as in {name}"))
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise mismatch(file, name, "NaN or infinity", "finite numbers")
    if array.size and field.low is not None and array.min() < field.low:
        raise mismatch(file, name, f"{array.min():g}", f"values of at least {field.low:g}")
    if array.size and field.high is not None and array.max() > field.high:
        raise mismatch(file, name, f"{array.max():g}", f"values of at most {field.high:g}")


def _resolve(
    shape: Sequence[int | str], found: Sequence[int], sizes: Mapping[str, tuple[int, str]]
) -> list[tuple[int, str]]:
    """The size that each axis must have and why; a letter not seen yet takes what was found."""
    return [
        (axis, f"{axis} entries") if isinstance(axis, int) else sizes.get(axis, (size, axis))
        for axis, size in zip(shape, found, strict=True)
    ]
