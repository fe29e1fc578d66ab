"""What it costs in bytes that files say what they are: of a store and of the results of a run.

    slgaussian run scenes.toml -o WORK/scenes --store WORK/scenes-store
    python -m benches.pipeline.metadata_overhead WORK [-o FILE]

Every table is encoded again without metadata, and of arrays the member that has them is taken out;
what is left is what the file was before it spoke. Runs of WORK are folders beside a folder of their
name and ``-store``.
"""

from __future__ import annotations

import argparse
import io
import zipfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from benches.common.pages import publish
from slgaussian.storage.specs import ABOUT

LOCAL, CENTRAL, END = 30, 46, 22
"""Bytes of a zip archive's headers of a member, without its name, and of the archive's own."""


def mute_bytes(file: Path) -> int:
    """Bytes that a Parquet or NPZ file would have without metadata."""
    if file.suffix == ".parquet":
        table, out = pq.read_table(file), io.BytesIO()
        plain = pa.schema([field.remove_metadata() for field in table.schema])
        pq.write_table(pa.Table.from_arrays(table.columns, schema=plain), out, compression="zstd")
        return len(out.getvalue())
    with zipfile.ZipFile(file) as archive:
        own = archive.getinfo(ABOUT)
    return file.stat().st_size - own.compress_size - LOCAL - CENTRAL - 2 * len(ABOUT)


def files_of(folder: Path) -> Iterator[tuple[str, Path]]:
    """Tables and arrays below a folder, each with its spec or, of results, its name."""
    for file in sorted(folder.rglob("*")):
        if file.suffix in (".parquet", ".npz") and ".prefect" not in file.parts:
            artifact = len(file.stem) == 64
            yield (file.parents[1].name if artifact else file.stem), file


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """A row a spec, and one of all, in order of bytes."""
    found: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for spec, file in files_of(folder):
        found[spec].append((file.stat().st_size, mute_bytes(file)))
    found["all"] = [pair for pairs in found.values() for pair in pairs]
    rows = []
    for spec, pairs in found.items():
        size, mute = (sum(numbers) for numbers in zip(*pairs, strict=True))
        rows.append(
            {
                "spec": spec,
                "files": len(pairs),
                "bytes": size,
                "each": (size - mute) / len(pairs),
                "share": (size - mute) / mute,
            }
        )
    return sorted(rows, key=lambda row: -row["bytes"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    runs = [
        {"name": store.name.removesuffix("-store"), "store": rows_of(store),
         "out": rows_of(store.with_name(store.name.removesuffix("-store")))}
        for store in sorted(given.work.glob("*-store"))
    ]  # fmt: skip
    publish("pipeline/metadata.md.j2", given.out and given.out / "metadata.md", runs=runs)


if __name__ == "__main__":
    main()
