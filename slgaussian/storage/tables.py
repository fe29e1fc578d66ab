"""Reading of untrusted Parquet tables with a bound on their unpacked size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

MAX_UNPACKED_BYTES = 8 * 2**30
"""Largest unpacked size of a file of arrays or a table, bytes."""

_WIDTHS = {"BOOLEAN": 1, "INT32": 4, "FLOAT": 4, "INT64": 8, "DOUBLE": 8, "INT96": 8}


def read_table(source: bytes | str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a table after computing and checking its unpacked size.

    The footer gives the size of numbers and pages. A text that a dictionary stores once may occur
    in any number of rows: if the bound could be exceeded, the dictionaries are read first and the
    lengths of the texts summed.

    Args:
        columns: sequence of str, optional. Names of the columns to read; default all.

    Raises:
        ValueError, OSError, ArrowException: If the file is damaged, or unpacks to more than
            :data:`MAX_UNPACKED_BYTES`.
    """
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    def open_file(texts: Sequence[str] = ()) -> pq.ParquetFile:
        # Takes a third of the time of pq.read_table, which also looks for a partitioned data set.
        place = pa.BufferReader(source) if isinstance(source, bytes) else source
        return pq.ParquetFile(place, read_dictionary=list(texts))

    file = open_file()
    total, worst = 0, dict[str, int]()
    for group in map(file.metadata.row_group, range(file.metadata.num_row_groups)):
        for number in range(group.num_columns):
            chunk = group.column(number)
            width = _WIDTHS.get(chunk.physical_type) or max(4, file.schema.column(number).length)
            total += chunk.total_uncompressed_size + width * (chunk.num_values + group.num_rows)
            if chunk.physical_type == "BYTE_ARRAY":
                bound = chunk.num_values * chunk.total_uncompressed_size
                worst[chunk.path_in_schema] = worst.get(chunk.path_in_schema, 0) + bound
    if total <= MAX_UNPACKED_BYTES < total + sum(worst.values()):
        for name, bound in worst.items():
            if "." in name:  # lists
                total += bound
                continue
            for texts in open_file([name]).read([name], use_threads=False).column(name).chunks:
                lengths = pc.binary_length(texts.dictionary.cast(pa.binary())).cast(pa.int64())
                total += pc.sum(lengths.take(texts.indices)).as_py() or 0
    if total > MAX_UNPACKED_BYTES:
        raise ValueError(f"it unpacks to more than {MAX_UNPACKED_BYTES >> 30} GiB")
    return file.read(columns, use_threads=False)
