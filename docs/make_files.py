"""Write `reference/files.md`: every file that the program stores, from `data_specs/`."""

from pathlib import Path

from slgaussian.storage.specs import UNITS, Spec, load_spec, spec_names

PAGE = Path(__file__).parent / "reference" / "files.md"

INTRODUCTION = """\
Made by `python docs/make_files.py` from `data_specs/`. Every file is checked against its spec when
it is written and when it is read. The TOML file of a spec has the type, unit, bounds and meaning
of each field; so have the metadata of every stored file, and `slgaussian inspect FILE` prints
them.

- **Tables** are Parquet; the metadata are those of the Arrow schema and of its columns.
- **Arrays** are NPZ; the metadata are in the member `about.json`.
- **Documents** are JSON.

`made` in the metadata names the program, the stage with its version and settings (files and
weights by their content), the specs of the inputs, and the versions of software; no time and no
place. A file names its spec as `slgaussian/labels@1`. A file of another version, or one that does
not fit its spec, is refused. How to read a file without this program:
[storage](../guides/storage.md#self-describing-files)."""

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
        rows = [_row(spec) for spec in specs if entries_of(spec)]
        text += [f"## {kind}", "\n".join(["| spec | content |", "| --- | --- |", *rows])]
    return "\n\n".join(text) + "\n"


def _row(spec: Spec) -> str:
    file = f"<br>`{spec.file}`" if spec.file else ""
    doc = spec.doc.replace("|", "\\|").replace("<", "&lt;")
    return f"| [{spec.name}@{spec.version}](../../data_specs/{spec.name}.toml){file} | {doc} |"


if __name__ == "__main__":
    PAGE.write_text(markdown(), "utf-8")
