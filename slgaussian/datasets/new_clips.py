"""Compare two looks at a corpus: clips that came, changed and went, and drift of their quality.

A clip is known by its key, and its content by a digest. A clip is one place: whatever is said of
new places is said of keys that were not there before.
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
"""Measures that are compared of clips, by column of spec ``clips``."""

SURE = 0.01
"""Probability, in a world without drift, below which a difference is called one."""

LEAST = 6
"""Clips on either side below which none is."""


@dataclass(frozen=True)
class Changes:
    """Keys of clips, each sorted.

    Attributes
    ----------
    arrived, changed : tuple of str
        Those that were not there before, and those that have another content now.
    withdrawn, damaged : tuple of str
        Those that were there before and are no more: taken away, or in what cannot be read now.
    """

    arrived: tuple[str, ...]
    changed: tuple[str, ...]
    withdrawn: tuple[str, ...]
    damaged: tuple[str, ...]


@dataclass(frozen=True)
class Drift:
    """A measure of the clips known before and of those that came.

    Attributes
    ----------
    measure : str
        One of the values of :data:`MEASURES`.
    known : (float, float, float)
        Lower quartile, median and upper quartile of the clips known before.
    come : float
        Median of those that came.
    drifted : bool
        Whether the median of those that came is outside the quartiles, and a two-sample
        Kolmogorov-Smirnov test tells them apart at :data:`SURE` over all measures (Bonferroni).
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

    ``failed`` are the names of the clips and chunks that could not be read now. A clip that is
    gone with such a chunk is damaged and not withdrawn: nobody took it away.
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


def drift(known: pa.Table, come: pa.Table) -> list[Drift]:
    """Compare each measure of the clips of two tables of spec ``clips``; none if one is empty."""
    drifts = []
    if not known.num_rows or not come.num_rows:
        return []
    enough = min(known.num_rows, come.num_rows) >= LEAST
    for name, measure in MEASURES.items():
        before, after = known[name].to_numpy(), come[name].to_numpy()
        low, middle, high = map(float, np.quantile(before, (0.25, 0.5, 0.75)))
        median = float(np.median(after))
        drifted = enough and not low <= median <= high
        drifted = drifted and ks_2samp(before, after).pvalue < SURE / len(MEASURES)
        drifts.append(Drift(measure, (low, middle, high), median, bool(drifted)))
    return drifts
