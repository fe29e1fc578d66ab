"""Compare two snapshots of a corpus: added, changed and removed clips.

A clip is identified by its key, and its content by a digest. A clip shows one place, so a new place
is a new key.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from slgaussian.storage.specs import load_spec


@dataclass(frozen=True)
class Changes:
    """Keys of clips, each sorted.

    Attributes:
        arrived, changed: tuple of str. New clips, and clips with changed content.
        withdrawn, damaged: tuple of str. Clips of the earlier snapshot that are missing: removed,
            or now unreadable.
    """

    arrived: tuple[str, ...]
    changed: tuple[str, ...]
    withdrawn: tuple[str, ...]
    damaged: tuple[str, ...]


def clips_of(views: pa.Table) -> pa.Table:
    """Summarise a table of spec ``views`` as one of spec ``clips``, by key."""
    table = views.sort_by([("clip", "ascending"), ("frame", "ascending")])
    names = np.array(table["clip"].to_pylist(), object)
    starts = [i for i in range(len(names)) if not i or names[i] != names[i - 1]]
    cameras = [
        c for c in table.column_names if c.startswith("w2c_") or c in ("fx", "fy", "cx", "cy")
    ]
    numbers = np.stack([table[name].to_numpy() for name in cameras], axis=1)
    digests, chunks = table["digest"].to_pylist(), table["chunk"].to_pylist()
    rows = []
    for start, end in zip(starts, [*starts, len(names)][1:], strict=True):
        content = hashlib.sha256("".join(digests[start:end]).encode())
        content.update(np.ascontiguousarray(numbers[start:end]).tobytes())
        row = {"clip": names[start], "chunk": chunks[start] or "", "views": end - start}
        rows.append({**row, "content": content.hexdigest()})
    return pa.Table.from_pylist(rows, schema=load_spec("clips").schema)


def changes(before: pa.Table, now: pa.Table, failed: Collection[str] = ()) -> Changes:
    """Compare two tables of spec ``clips``.

    ``failed`` are the names of the clips and chunks that could not be read now. A missing clip of
    such a chunk is damaged, not withdrawn.
    """
    was, has = contents(before), contents(now)
    chunk_of = dict(zip(before["clip"].to_pylist(), before["chunk"].to_pylist(), strict=True))
    gone = sorted(was.keys() - has.keys())
    damaged = {clip for clip in gone if clip in failed or chunk_of[clip] in failed}
    return Changes(
        arrived=tuple(sorted(has.keys() - was.keys())),
        changed=tuple(sorted(clip for clip in was.keys() & has.keys() if was[clip] != has[clip])),
        withdrawn=tuple(clip for clip in gone if clip not in damaged),
        damaged=tuple(clip for clip in gone if clip in damaged),
    )


def contents(clips: pa.Table) -> dict[str, str]:
    """Return the digest of each clip's content by its key."""
    return dict(zip(clips["clip"].to_pylist(), clips["content"].to_pylist(), strict=True))
