"""Backlog of a configuration: scenes without a complete result, and the time to compute them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.benchmark.reports.text_table import table_text
from slgaussian.storage.encoding import load_table
from slgaussian.storage.records import FOLDER, NotStoredError, OutdatedError, Records

GAPS = {NotStoredError.__name__: "missing", OutdatedError.__name__: "outdated"}
"""State of the first stage of a scene without a result, by the error of the look-up; by another
error, such as unreadable photographs, it is ``failed``."""

STATES = ("stored", *GAPS.values(), "failed", "waiting")
"""States of a stage of a scene; one waits for the results of the stages before it."""

SAMPLE = 100
"""Number of records of a stage from which its time is estimated."""

PERCENTILES = (10, 50, 90)
"""Percentiles of the seconds in the records: low, usual and high estimate."""

MAX_LISTED = 40
"""Largest number of scenes in a text."""


def summarise(
    groups: Iterable[tuple[Iterable[Any], Mapping[str, int]]],
    failures: Path,
    records: Records,
    workers: int,
) -> dict[str, Any]:
    """Return the backlog as plain data.

    Args:
        groups: Results of looked-up scenes (``scene``, ``refs`` by stage, ``failure`` or None with
            ``stage``, ``kind`` and ``reason``), with the versions of all their stages, in order.
        failures: Table of the last run; its reasons take precedence. It may be missing.

    Returns:
        dict: ``total`` and ``complete``: numbers of scenes. ``stages``: the number of scenes by
            stage and state, and the ``seconds`` of a computation (:func:`_seconds`). ``seconds``:
            those of all computations by a number of workers; ``unknown``: the stages of which no
            record tells. ``gaps``: scene, stage, state and reason.

    Raises:
        SpecError: If the table is damaged.
    """
    table = load_table(failures, "failures", "run it again") if failures.is_file() else None
    rows = [] if table is None else table.to_pylist()
    reported = {(row["scene"], row["stage"]): row["reason"] for row in rows}
    counts, versions = defaultdict[str, Counter[str]](Counter), dict[str, int]()
    gaps, scenes, unknown = [], 0, []
    for results, stages in groups:
        names = list(stages)
        versions |= stages
        for result in results:
            scenes += 1
            states, gap = dict.fromkeys(result.refs, "stored"), result.failure
            if gap is not None:
                last = reported.get((result.scene, gap.stage))
                state = GAPS.get(gap.kind, "failed") if last is None else "failed"
                behind = names[names.index(gap.stage) + 1 :] if gap.stage in names else names
                states |= {gap.stage: state} | dict.fromkeys(behind, "waiting")
                facts = result.scene, gap.stage, state, last or gap.reason
                gaps.append(dict(zip(("scene", "stage", "state", "reason"), facts, strict=True)))
            for stage, state in states.items():
                counts[stage][state] += 1
    stage_rows, total = {}, np.zeros(len(PERCENTILES))
    for stage, version in versions.items():
        left = counts[stage].total() - counts[stage]["stored"]
        seconds = _seconds(records, stage, version) if left else None
        if seconds is not None:
            total += left * np.array(seconds) / workers
        elif left:
            unknown.append(stage)
        if counts[stage]:
            row = {state: counts[stage][state] for state in STATES}
            stage_rows[stage] = {**row, "seconds": seconds}
    counted = {"total": scenes, "complete": scenes - len(gaps), "workers": workers}
    times = {"seconds": total.tolist(), "unknown": unknown}
    return {**counted, **times, "stages": stage_rows, "gaps": gaps}


def _seconds(records: Records, stage: str, version: int) -> list[float] | None:
    """Return the :data:`PERCENTILES` of the seconds of the newest version that has any records.

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
    stages, gaps = backlog["stages"], [list(gap.values()) for gap in backlog["gaps"]]
    shown = [state for state in STATES if any(counts[state] for counts in stages.values())]
    rows = [["stage", *shown, "seconds each"]]
    for stage, counts in stages.items():
        seconds = "" if counts["seconds"] is None else _range(counts["seconds"])
        rows.append([stage, *(str(counts[state]) for state in shown), seconds])
    line = f"complete: {backlog['complete']} of {backlog['total']}"
    if any(backlog["seconds"]):
        minutes = _range([seconds / 60 for seconds in backlog["seconds"]])
        line += f"; the rest takes {minutes} minutes, workers: {backlog['workers']}"
    if backlog["unknown"]:
        line += f"; without a record of its time: {', '.join(backlog['unknown'])}"
    blocks = [table_text(rows), line]
    if gaps:
        blocks.append(
            table_text([["scene", "stage", "state", "reason"], *gaps[:MAX_LISTED]], "<<<<")
        )
    if gaps[MAX_LISTED:]:
        blocks.append(f"and {len(gaps) - MAX_LISTED} more, see --json")
    return "\n\n".join(blocks)


def _range(values: list[float]) -> str:
    low, usual, high = values
    return f"{usual:.3g} ({low:.3g} to {high:.3g})"
