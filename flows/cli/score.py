"""Score masks that were made elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flows import scoring
from flows.cli.tables import masks_tables
from flows.settings import Settings
from slgaussian.benchmark.protocols import load_protocol

NAMED = 3
"""So many are named of masks that are missing, or that nothing asks for."""


def score(
    settings: Settings, place: Path, protocols: Sequence[str], out: Path
) -> tuple[str, list[str]]:
    """Score masks; return the table of their scores, and notes on them, a line each."""
    scores = scoring.score(settings, place, protocols, out)
    rows = [row for result in scores.results for row in result.rows]
    notes, tally = [*scores.said], scores.tally
    if tally.missing:
        notes.append(
            f"missing: {tally.missing} of {tally.asked} samples have no mask and count as an empty "
            f"one: {_few(list(dict.fromkeys(tally.missing_of)))}"
        )
    for kind, names in tally.unknown(scores.predictions).items():
        notes.append(f"not asked, left out: {kind} {_few(names)}")
    empty = ["what needs relevancies (threshold-free, peaks)"]
    if all(row["point_x"] is None for row in rows):
        empty.append("what needs points (point in mask, point in box)")
    labels = {row["protocol"] for row in rows}
    if load_protocol("slgaussian").label in labels and load_protocol("3d-ovs").label not in labels:
        empty.append("mIoU, for which all texts compete (masks of 3d-ovs say which wins)")
    return masks_tables(rows), [*notes, f"left empty: {'; '.join(empty)}"]


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
