"""Backlog of a configuration: scenes without a complete result, and the time to compute them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.benchmark.reports.text_table import table_text
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.records import FOLDER, NotStoredError, OutdatedError, Records
from slgaussian.storage.specs import load_spec

GAPS = ("missing", "outdated", "failed")
"""States of the first stage of a scene without a result: there is none; an older version of the
stage has one; the scene was left out there by the last run, or its input cannot be read."""

STATES = ("stored", *GAPS, "waiting")
"""States of a stage of a scene; one waits for the results of the stages before it."""

SAMPLE = 100
"""Number of records of a stage from which its time is estimated."""

PERCENTILES = (10, 50, 90)
"""Percentiles of the seconds in the records: low, usual and high estimate."""

MAX_LISTED = 40
"""Largest number of scenes in a text."""


STATE_BY_ERROR = {NotStoredError.__name__: "missing", OutdatedError.__name__: "outdated"}


@dataclass(frozen=True)
class Walk:
    """A scene and its stages.

    Attributes:
        versions: {stage: its version}, in order.
        states: {stage: one of :data:`STATES`}.
        reason: Of the gap; empty if all results are stored.
    """

    scene: str
    versions: Mapping[str, int]
    states: Mapping[str, str]
    reason: str = ""


def walk_scene(
    scene: str,
    versions: Mapping[str, int],
    stored: Iterable[str],
    gap: tuple[str, str, str] | None,
    reported: Mapping[tuple[str, str], str],
) -> Walk:
    """Return the walk of a scene through stages, of which it may lack some before the gap.

    Args:
        gap: Stage, kind of error and reason.
        reported: {(scene, stage): reason}. Failures of the last run.
    """
    if gap is None:
        return Walk(scene, versions, dict.fromkeys(stored, "stored"))
    stage, kind, reason = gap
    state, names = STATE_BY_ERROR.get(kind, "failed"), list(versions)
    if (scene, stage) in reported:
        state, reason = "failed", reported[scene, stage]
    behind = names[names.index(stage) + 1 :] if stage in names else names
    states = dict.fromkeys(stored, "stored") | {stage: state} | dict.fromkeys(behind, "waiting")
    return Walk(scene, versions, states, reason)


def read_failures(file: Path) -> dict[tuple[str, str], str]:
    """Read the reasons in a table of spec ``failures``, by scene and stage; none without a file.

    SpecError if the table is damaged.
    """
    if not file.is_file():
        return {}
    table = decode_table(file.read_bytes(), load_spec("failures"), str(file), "run it again")
    return {(row["scene"], row["stage"]): row["reason"] for row in table.to_pylist()}


def summarise(walks: Iterable[Walk], records: Records, workers: int) -> dict[str, Any]:
    """Return the backlog as plain data.

    Returns:
        dict: ``total`` and ``complete``: numbers of scenes. ``stages``: the number of scenes by
            stage and state, and the ``seconds`` of a computation, by the records of the newest
            version that has any: :data:`PERCENTILES`, or None. ``seconds``: those of all
            computations by a number of workers; ``unknown``: the stages of which no record tells.
            ``gaps``: scene, stage, state and reason.
    """
    walks = list(walks)
    stages: dict[str, dict[str, Any]] = {}
    total, unknown = np.zeros(len(PERCENTILES)), []
    for stage, version in {s: v for walk in walks for s, v in walk.versions.items()}.items():
        counts = Counter(walk.states[stage] for walk in walks if stage in walk.states)
        left = counts.total() - counts["stored"]
        seconds = _seconds(records, stage, version) if left else None
        if seconds is not None:
            total += left * np.array(seconds) / workers
        elif left:
            unknown.append(stage)
        stages[stage] = {state: counts[state] for state in STATES} | {"seconds": seconds}
    gaps = [
        {"scene": walk.scene, "stage": stage, "state": state, "reason": walk.reason}
        for walk in walks
        for stage, state in walk.states.items()
        if state in GAPS
    ]
    counted = {"total": len(walks), "complete": len(walks) - len(gaps), "workers": workers}
    times = {"seconds": total.tolist(), "unknown": unknown}
    return {**counted, **times, "stages": stages, "gaps": gaps}


def _seconds(records: Records, stage: str, version: int) -> list[float] | None:
    """Return the :data:`PERCENTILES` of the seconds of a stage; None without a record.

    Records are read folder by folder: their names are digests, so the first are a fair sample.
    """
    for older in range(version, 0, -1):
        seconds: list[float] = []
        for batch in records.all(f"{FOLDER}/{stage}/v{older}"):
            seconds += [record.ref.meta["seconds"] for record in batch if record.ref is not None]
            if len(seconds) >= SAMPLE:
                break
        if seconds:
            return np.percentile(seconds, PERCENTILES).tolist()
    return None


def as_text(backlog: Mapping[str, Any]) -> str:
    """Return the result of :func:`summarise` as text."""
    shown = [s for s in STATES if any(counts[s] for counts in backlog["stages"].values())]
    rows = [["stage", *shown, "seconds each"]]
    for stage, counts in backlog["stages"].items():
        seconds = "" if counts["seconds"] is None else _range(counts["seconds"])
        rows.append([stage, *(str(counts[state]) for state in shown), seconds])
    line = f"complete: {backlog['complete']} of {backlog['total']}"
    if any(backlog["seconds"]):
        minutes = [seconds / 60 for seconds in backlog["seconds"]]
        line += f"; the rest takes {_range(minutes)} minutes, workers: {backlog['workers']}"
    if backlog["unknown"]:
        line += f"; without a record of its time: {', '.join(backlog['unknown'])}"
    blocks = [table_text(rows), line]
    if gaps := [list(gap.values()) for gap in backlog["gaps"][:MAX_LISTED]]:
        blocks.append(table_text([["scene", "stage", "state", "reason"], *gaps], "<<<<"))
    if rest := len(backlog["gaps"]) - len(gaps):
        blocks.append(f"and {rest} more, see --json")
    return "\n\n".join(blocks)


def _range(values: list[float]) -> str:
    low, usual, high = values
    return f"{usual:.3g} ({low:.3g} to {high:.3g})"
