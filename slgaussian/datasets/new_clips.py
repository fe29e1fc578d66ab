"""Compare two snapshots of a corpus: added, changed and removed clips, and drift of their quality.

A clip is identified by its key, and its content by a digest. A clip shows one place, so a new place
is a new key.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from scipy.stats import ks_2samp

from slgaussian.storage.specs import load_spec

MEASURES = {"blur": "blur", "mean": "exposure", "clipped": "black or white"}
"""Compared measures of clips, by column of spec ``clips``."""

SURE = 0.01
"""Significance level of the drift test."""

LEAST = 6
"""Smallest number of clips in each snapshot for the drift test."""


@dataclass(frozen=True)
class Changes:
    """Keys of clips, each sorted.

    Attributes
    ----------
    arrived, changed : tuple of str
        New clips, and clips with changed content.
    withdrawn, damaged : tuple of str
        Clips of the earlier snapshot that are missing: removed, or now unreadable.
    """

    arrived: tuple[str, ...]
    changed: tuple[str, ...]
    withdrawn: tuple[str, ...]
    damaged: tuple[str, ...]


@dataclass(frozen=True)
class Drift:
    """Comparison of a measure between the earlier and the new clips.

    Attributes
    ----------
    measure : str
        One of the values of :data:`MEASURES`.
    known : (float, float, float)
        Lower quartile, median and upper quartile of the earlier clips.
    come : float
        Median of the new clips.
    drifted : bool
        Whether the median of the new clips is outside the quartiles, and a two-sample
        Kolmogorov-Smirnov test rejects equality at level :data:`SURE` (Bonferroni-corrected).
    """

    measure: str
    known: tuple[float, float, float]
    come: float
    drifted: bool


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
    measured = {name: table[name].to_numpy() for name in MEASURES}
    rows = []
    for start, end in zip(starts, [*starts, len(names)][1:], strict=True):
        content = hashlib.sha256("".join(digests[start:end]).encode())
        content.update(np.ascontiguousarray(numbers[start:end]).tobytes())
        row = {"clip": names[start], "chunk": chunks[start] or "", "views": end - start}
        row |= {name: float(of[start:end].mean()) for name, of in measured.items()}
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


def drift(earlier: pa.Table, new: pa.Table) -> list[Drift]:
    """Compare each measure between two tables of spec ``clips``; empty if one table is empty."""
    drifts = []
    if not earlier.num_rows or not new.num_rows:
        return []
    enough = min(earlier.num_rows, new.num_rows) >= LEAST
    for name, measure in MEASURES.items():
        before, after = earlier[name].to_numpy(), new[name].to_numpy()
        low, middle, high = map(float, np.quantile(before, (0.25, 0.5, 0.75)))
        median = float(np.median(after))
        drifted = enough and not low <= median <= high
        drifted = drifted and ks_2samp(before, after).pvalue < SURE / len(MEASURES)
        drifts.append(Drift(measure, (low, middle, high), median, bool(drifted)))
    return drifts
