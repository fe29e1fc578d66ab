"""What `slgaussian score` prints of masks that were made elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flows.cli.tables import given_tables
from flows.scoring import Scores
from flows.scoring import score as scored
from flows.settings import Settings
from slgaussian.benchmark.protocols import load_protocol

NAMED = 3
"""So many are named of masks that are missing, or that nothing asks for."""


def score(
    settings: Settings, place: Path, protocols: Sequence[str], out: Path
) -> tuple[str, list[str]]:
    """Score masks; the table of their scores, and what is to be known of them, a line each."""
    found = scored(settings, place, protocols, out)
    table = given_tables([row for result in found.results for row in result.rows])
    return table, [*found.said, *_missing(found), *_unknown(found), *_left_empty(found)]


def _missing(found: Scores) -> list[str]:
    tally = found.tally
    if not tally.missing:
        return []
    return [
        f"missing: {tally.missing} of {tally.asked} samples have no mask and count as an empty "
        f"one: {_few(list(dict.fromkeys(tally.missing_of)))}"
    ]


def _unknown(found: Scores) -> list[str]:
    unknown = found.tally.unknown(found.predictions)
    return [f"not asked, left out: {what} {_few(names)}" for what, names in unknown.items()]


def _left_empty(found: Scores) -> list[str]:
    rows = [row for result in found.results for row in result.rows]
    names = {row["protocol"] for row in rows}
    without = ["what needs relevancies (threshold-free, peaks)"]
    if all(row["point_x"] is None for row in rows):
        without.append("what needs points (point in mask, point in box)")
    if load_protocol("slgaussian").label in names and load_protocol("3d-ovs").label not in names:
        without.append("mIoU, for which all texts compete (masks of 3d-ovs say which wins)")
    return [f"left empty: {'; '.join(without)}"]


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
