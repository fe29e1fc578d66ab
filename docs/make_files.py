"""Write `reference/files.md`: every file that the program stores, from `data_specs/`."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from slgaussian.storage.specs import UNITS, Entry, Spec, load_spec, spec_names

PAGE = Path(__file__).parent / "reference" / "files.md"

INTRODUCTION = """\
Made by `python docs/make_files.py` from `data_specs/`, which every file is checked against when it
is written and when it is read.

- **Tables** are Parquet. Arrow's metadata of the schema have `spec`, `meaning`, `made` and, where
  they are known, `source` and `licence`; those of each column `meaning`, `unit`, `low`, `high` and
  `values`.
- **Arrays** are NPZ, with the same in a member `about.json`.
- **Documents** are JSON.

`made` names the program, the stage and its version, its settings (files and weights by their
content), the specs of what it was made of, and the versions of software: nothing of when or where.
A file says its spec as `slgaussian/labels@1`: a version is raised when older files are no longer
what the spec says. A file of a later version is refused, and so is an older one that does not
pass; files from before specs were named are read if they pass. `slgaussian inspect FILE` checks a
file and shows its spec, what made it and its digest.
How to read it without this program:
[storage](../guides/storage.md#a-file-by-itself)."""

KINDS = {
    "Tables": lambda spec: spec.columns,
    "Arrays": lambda spec: spec.fields or spec.open,
    "Documents": lambda spec: spec.keys,
}


def markdown() -> str:
    """The page."""
    specs = [load_spec(name) for name in spec_names()]
    text = ["# Every stored file", INTRODUCTION, _units()]
    for kind, holds in KINDS.items():
        text.append(f"## {kind}")
        for spec in specs:
            if holds(spec):
                text += _section(spec)
    return "\n\n".join(text) + "\n"


def _units() -> str:
    rows = [f"| {unit} | {meaning} |" for unit, meaning in UNITS.items()]
    return "\n".join(["| unit | |", "| --- | --- |", *rows])


def _section(spec: Spec) -> Iterator[str]:
    called = f", `{spec.file}`" if spec.file else ""
    yield f"### {spec.name}@{spec.version}{called}"
    yield spec.doc
    entries: Mapping[str, Entry] = spec.fields or spec.columns or spec.keys
    if entries:
        rows = [_row(name, entry, bool(spec.fields)) for name, entry in entries.items()]
        yield "\n".join(
            ["| name | type | unit | values | |", "| --- | --- | --- | --- | --- |", *rows]
        )
    if spec.axes:
        yield "Axes: " + "; ".join(f"{letter}: {said}" for letter, said in spec.axes.items()) + "."


def _row(name: str, entry: Entry, has_shape: bool) -> str:
    kind = entry.type
    if has_shape:
        kind += f" [{', '.join(map(str, entry.shape))}]"
    notes = ["may be empty"] * entry.nullable + ["may be missing"] * entry.optional
    kind = ", ".join([kind, *notes])
    doc = entry.doc.replace("|", "\\|").replace("<", "&lt;")
    return f"| `{name}` | {kind} | {entry.unit} | {_values(entry)} | {doc} |"


def _values(entry: Entry) -> str:
    if entry.values:
        return ", ".join(map(str, entry.values))
    low, high = ("" if end is None else f"{end:g}" for end in (entry.low, entry.high))
    if low and high:
        return f"{low} to {high}"
    return f"at least {low}" if low else f"at most {high}" if high else ""


if __name__ == "__main__":
    PAGE.write_text(markdown(), "utf-8")
