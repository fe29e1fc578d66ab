"""Specs of stored data, one ``.toml`` file each, and their validator.

A spec with ``fields`` lists named arrays with dtype and shape; the letters of a shape are axes,
whose sizes must agree within one artifact. A spec with ``columns`` lists those of a table. Both are
checked when an artifact is written and again when it is read.

A spec with ``keys`` lists those of a JSON file. In a key, ``*`` stands for any name in an object
and ``[]`` for every item of a list.

A spec has a version. Files contain its name, version and meaning, and the unit, bounds and meaning
of each field, in Parquet as Arrow's metadata of fields and schema, in NPZ as a JSON member
:data:`METADATA_FILE`. :mod:`slgaussian.storage.provenance` adds the provenance.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian.errors import SpecError

if TYPE_CHECKING:  # reading arrays does not need Arrow, whose import takes 0.1 s
    import pyarrow as pa

METADATA_FILE = "about.json"
"""Member of an ``.npz`` file with the metadata: spec, meaning of the arrays, provenance."""

OWNER = "slgaussian"
"""Namespace of the specs: a file names its spec as ``slgaussian/labels@1``."""

UNITS = {
    "1": "a dimensionless number, such as a fraction, a ratio or a direction",
    "count": "a number of items",
    "id": "an identifier: numbers that are only compared for equality",
    "index": "a position in an order, from 0 unless the meaning says otherwise",
    "pixel": "pixels; the centre of the first one is at 0.5",
    "scene unit": "the unit of length of the scene's cameras; metres if they are metric",
    "second": "seconds",
    "microsecond": "microseconds",
    "byte": "bytes of 8 bits",
    "octet": "one byte of a file stored in the array, in the format that the meaning gives",
    "decibel": "dB",
    "grey level": "0 (black) to 255 (white)",
}
"""Meaning of every unit of the specs."""

ROUNDING = 1e-9
"""Tolerance of the bounds of table columns, as a sum of fractions may be rounded above 1."""


def arrow_type(name: str) -> pa.DataType:
    """Return Arrow's type for its name in specs, such as ``float64`` or ``string list``."""
    import pyarrow as pa

    kind = pa.type_for_alias(name.removesuffix(" list"))
    return pa.list_(kind) if name.endswith(" list") else kind


@dataclass(frozen=True)
class Entry:
    """One array of an artifact, one column of a table or one value of a JSON file.

    Attributes:
        type: For arrays a NumPy dtype, or ``str`` for text of any length; for columns a name of
            :func:`arrow_type`; for JSON values ``text``, ``integer``, ``number``, ``bool``,
            ``object``, ``list`` or ``any``.
        shape: tuple of int and str. Shape of an array: sizes, and letters of ``Spec.axes``.
        nullable, optional: Whether a value may be null, and whether it may be missing.
        unit: One of :data:`UNITS`; empty for text, booleans and objects.
        low, high: Inclusive bounds of the values, or of the items of lists. Floats must be finite.
        values: tuple. All allowed values; empty if any value is allowed.
    """

    type: str
    doc: str
    shape: tuple[int | str, ...] = ()
    nullable: bool = False
    optional: bool = False
    unit: str = ""
    low: float | None = None
    high: float | None = None
    values: tuple[str | int, ...] = ()

    def describe(self, plain: bool = False) -> dict[str, Any]:
        """Return meaning, unit, bounds and values, as text for Arrow or as ``plain`` data."""
        entries: dict[str, Any] = {"meaning": self.doc, "unit": self.unit}
        entries |= {"low": self.low, "high": self.high, "values": list(self.values)}
        stated = {name: value for name, value in entries.items() if value not in (None, "", [])}
        if plain:
            return stated
        return {n: v if isinstance(v, str) else json.dumps(v) for n, v in stated.items()}


@dataclass(frozen=True)
class Spec:
    """One kind of file: ``fields`` of an ``.npz``, ``columns`` of a table or ``keys`` of JSON.

    Attributes:
        version: Increased by hand with every change; files of other versions are not read.
        compress: Whether arrays are compressed.
        file: File name outside a store, if it is always the same.
        axes: Meaning of each letter of a shape.
        open: Whether the arrays have arbitrary names, which are not listed.
    """

    name: str
    doc: str
    version: int = 1
    compress: bool = True
    open: bool = False
    file: str = ""
    axes: Mapping[str, str] = field(default_factory=dict)
    fields: Mapping[str, Entry] = field(default_factory=dict)
    columns: Mapping[str, Entry] = field(default_factory=dict)
    keys: Mapping[str, Entry] = field(default_factory=dict)

    @cached_property
    def label(self) -> str:
        """Name of the spec in a file."""
        return f"{OWNER}/{self.name}@{self.version}"

    @cached_property
    def suffix(self) -> str:
        """File name ending of the artifact."""
        if self.keys:
            return ".json"
        return ".parquet" if self.columns else ".npz"

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of a table spec, with its metadata."""
        import pyarrow as pa

        columns = [
            pa.field(name, arrow_type(column.type), column.nullable, column.describe())
            for name, column in self.columns.items()
        ]
        return pa.schema(columns, {"spec": self.label, "meaning": self.doc})

    def about(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the metadata of an ``.npz`` file with the arrays ``names``, as plain data."""
        listed = {name: self.fields[name] for name in names if name in self.fields}
        letters = {axis for entry in listed.values() for axis in entry.shape}
        return {
            "spec": self.label,
            "meaning": self.doc,
            "axes": {letter: text for letter, text in self.axes.items() if letter in letters},
            "fields": {
                name: {"axes": list(entry.shape), **entry.describe(plain=True)}
                for name, entry in listed.items()
            },
        }

    def check_label(self, label: str | None, file: str, repair: str) -> None:
        """Raise :class:`SpecError` if a file with this label has another spec or version of it."""
        if label != self.label:
            raise mismatch(file, "spec", f"{label or 'none'!s:.80}", f"{self.label}; {repair}")

    def check_arrays(self, arrays: Mapping[str, np.ndarray], file: str) -> None:
        """Raise :class:`SpecError` at the first array that breaks this spec."""
        if self.open:
            return
        unknown = sorted(set(arrays) - set(self.fields))
        if unknown:
            raise mismatch(file, unknown[0], "an unknown field", f"only {', '.join(self.fields)}")
        sizes: dict[str, tuple[int, str]] = {}
        for name, entry in self.fields.items():
            if name in arrays:
                _check_array(arrays[name], entry, name, file, sizes)
            elif not entry.optional:
                raise mismatch(file, name, "no such field", _shape_text(entry))

    def check_table(self, table: pa.Table, file: str) -> None:
        """Raise :class:`SpecError` at the first column that breaks this spec."""
        import pyarrow as pa
        import pyarrow.compute as pc

        for name, column in self.columns.items():
            if name not in table.column_names:
                raise mismatch(file, name, "no such column", f"a {column.type} column")
            data, expected = table.column(name), arrow_type(column.type)
            if data.type != expected:
                raise mismatch(file, name, f"{data.type}", f"{expected}")
            if data.null_count and not column.nullable:
                raise mismatch(file, name, f"{data.null_count} empty cells", "a value in each row")
            while pa.types.is_list(data.type):
                data = pc.list_flatten(data)
                if data.null_count:
                    found = f"{data.null_count} empty items in its lists"
                    raise mismatch(file, name, found, "a value in each item")
            has_bounds = column.values or column.low is not None or column.high is not None
            if pa.types.is_floating(data.type) or has_bounds:
                _check_values(data.drop_null().to_numpy(), column, name, file, ROUNDING)
        unknown = [name for name in table.column_names if name not in self.columns]
        if unknown:
            raise mismatch(file, unknown[0], "an unknown column", f"only {list(self.columns)}")


@cache
def load_spec(name: str) -> Spec:
    """Load the spec called ``name``.

    Raises:
        SpecError: If there is no such spec; the message lists all specs.
    """
    if name not in spec_names():
        raise SpecError(f"no data spec {name!r}: expected one of {', '.join(spec_names())}")
    raw = tomllib.loads((files("data_specs") / f"{name}.toml").read_text("utf-8"))
    for part in ("fields", "columns", "keys"):
        entries = raw[part] = dict(raw.get(part, {}))
        for entry, table in entries.items():
            lists = {key: tuple(value) for key, value in table.items() if isinstance(value, list)}
            entries[entry] = Entry(**(table | lists))
    return Spec(name=name, **raw)


@cache
def spec_names() -> tuple[str, ...]:
    """List the names of all specs, sorted."""
    names = (entry.name for entry in files("data_specs").iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def parse_label(label: str) -> tuple[str, int]:
    """Split the label of a spec into name and version; return any other text with version 0."""
    match = re.fullmatch(rf"{OWNER}/([a-z_]+)@([1-9]\d{{0,5}})", label)
    return (label, 0) if match is None else (match[1], int(match[2]))


def mismatch(file: str, field: str, actual: str, expected: str) -> SpecError:
    """Return a :class:`SpecError` with the file, the field, the actual and the expected."""
    return SpecError(f"{file}: {field}: found {actual}, expected {expected}")


def _check_values(
    values: np.ndarray, entry: Entry, name: str, file: str, slack: float = 0.0
) -> None:
    """Raise :class:`SpecError` if values are not finite, or not allowed by the entry."""
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise mismatch(file, name, "NaN or infinity", "finite numbers")
    if entry.values:
        invalid = sorted(set(np.unique(values).tolist()) - set(entry.values))
        if invalid:
            raise mismatch(file, name, f"{invalid[0]!r:.80}", f"one of {list(entry.values)}")
    # Only one pass over the array for each bound, as arrays may be large.
    if entry.low is not None and values.size and (minimum := values.min()) < entry.low - slack:
        raise mismatch(file, name, f"{minimum:g}", f"values of at least {entry.low:g}")
    if entry.high is not None and values.size and (maximum := values.max()) > entry.high + slack:
        raise mismatch(file, name, f"{maximum:g}", f"values of at most {entry.high:g}")


def _check_array(
    array: np.ndarray, field: Entry, name: str, file: str, sizes: dict[str, tuple[int, str]]
) -> None:
    """Check an array; ``sizes`` has the size of each axis so far, and the array that set it."""
    actual, expected = f"{array.dtype} {list(array.shape)}", _shape_text(field)
    fits = array.dtype.kind == "U" if field.type == "str" else array.dtype == field.type
    if not fits or array.ndim != len(field.shape):
        raise mismatch(file, name, actual, expected)
    for axis, size in zip(field.shape, array.shape, strict=True):
        if isinstance(axis, int):
            needed, reason = axis, f"{axis} entries"
        else:
            needed, first = sizes.setdefault(axis, (size, name))
            reason = f"{axis} = {needed} as in {first}"
        if size != needed:
            raise mismatch(file, name, actual, f"{expected} with {reason}")
    if np.ma.is_masked(array):  # a file stores what lies below the mask
        raise mismatch(file, name, f"{np.ma.count_masked(array)} masked values", "a value in each")
    _check_values(array, field, name, file)


def _shape_text(field: Entry) -> str:
    return f"{field.type} [{', '.join(map(str, field.shape))}]"
