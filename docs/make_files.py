"""Write `reference/files.md`: every file that the program stores, from `data_specs/`."""

from collections.abc import Mapping
from pathlib import Path

from slgaussian.storage.specs import UNITS, Entry, Spec, load_spec, spec_names

PAGE = Path(__file__).parent / "reference" / "files.md"

INTRODUCTION = """\
Made by `python docs/make_files.py` from `data_specs/`, which every file is checked against when it
is written and when it is read. The TOML file of a spec has the type, unit, bounds and meaning of
each field, and so have the metadata of every stored file.

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
    """Return the page: the units, and a table of specs for each kind of file."""
    units = "\n".join(f"- {unit}: {meaning}" for unit, meaning in UNITS.items())
    text = ["# Every stored file", INTRODUCTION, f"Units:\n\n{units}"]
    specs = [load_spec(name) for name in spec_names()]
    for kind, entries_of in KINDS.items():
        rows = [_row(spec, entries_of(spec)) for spec in specs if entries_of(spec)]
        text += [
            f"## {kind}",
            "\n".join(["| spec | holds | fields |", "| --- | --- | --- |", *rows]),
        ]
    return "\n\n".join(text) + "\n"


def _row(spec: Spec, entries: Mapping[str, Entry] | bool) -> str:
    file = f"<br>`{spec.file}`" if spec.file else ""
    names = ", ".join(f"`{name}`" for name in entries) if isinstance(entries, Mapping) else "any"
    doc = spec.doc.replace("|", "\\|").replace("<", "&lt;")
    link = f"[{spec.name}@{spec.version}](../../data_specs/{spec.name}.toml)"
    return f"| {link}{file} | {doc} | {names} |"


if __name__ == "__main__":
    PAGE.write_text(markdown(), "utf-8")
