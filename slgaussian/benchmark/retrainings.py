"""History of the retrainings in a folder of versions: ``history.parquet``, a row for each."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.drift import compare_lessons, find_drifts, lesson_distributions
from slgaussian.benchmark.significance import clip_scores
from slgaussian.benchmark.statistics import interval_of_mean
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.tables import read_table

COLUMNS = {"branch": "candidate", "before": "before", "hard": "hard", "filled": "filled"}
"""Beginnings of the columns of scores, by lifting."""

LISTED = 10
"""Number of retrainings in tables for readers."""


class History:
    """The history in a folder of versions, to add a retraining to.

    All is read at once, so that a damaged file ends a retraining before its work.

    Raises:
        SpecError: As :func:`read_history`.
    """

    def __init__(self, models: Path) -> None:
        self.models = models
        self.table, self._last_lessons = read_history(models), _read_table(models, "distributions")

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row with the time and write ``history.parquet``; what the row lacks is empty."""
        schema = load_spec("history").schema
        lists: dict[str, Any] = {f.name: [] for f in schema if pa.types.is_list(f.type)}
        now = datetime.now(UTC).isoformat(timespec="seconds")
        added = pa.Table.from_pylist([{"ended": now, **lists, **row}], schema=schema)
        self.table = pa.concat_tables([self.table.cast(schema), added])
        self._write("history", self.table)

    def compare_lessons(self, lessons: pa.Table, pairs: Path, version: int) -> dict[str, Any]:
        """Compare lessons with those of the last version; return the columns of a row on drift.

        Then they replace those in ``distributions.parquet``. ``lessons`` is a table of this spec,
        ``pairs`` the file of their samples, ``version`` the one that learnt from them.
        """
        now, then = lesson_distributions(lessons, read_table(pairs), version), self._last_lessons
        self._write("distributions", now)
        if not then.num_rows:
            return {}
        return {"against": then["version"][0].as_py(), **compare_lessons(then, now)}

    def _write(self, name: str, table: pa.Table) -> None:
        spec = load_spec(name)
        spec.check_table(table, spec.file)
        write_atomic(self.models / spec.file, encode_table(table, spec))


def read_history(models: Path) -> pa.Table:
    """Read the history in a folder of versions; without a row if there is none.

    Raises:
        SpecError: If the file is damaged, or of another version of the program.
    """
    return _read_table(models, "history")


def _read_table(models: Path, name: str) -> pa.Table:
    spec = load_spec(name)
    file = models / spec.file
    if not file.exists():
        return spec.schema.empty_table()
    repair = "move it elsewhere, and a new one begins"
    return decode_table(file.read_bytes(), spec, str(file), repair)


def count_lessons(lessons: pa.Table, places: Mapping[str, str]) -> dict[str, int]:
    """Return the counts of a row, of a table of spec ``lessons`` and the places of its clips."""
    clips = set(lessons["clip"].to_pylist())
    return {
        "lessons": lessons.num_rows,
        "clips": len(clips),
        "places": len({places.get(clip, clip) for clip in clips}),
        "objects": sum(lessons["objects"].to_pylist()),
    }


def score_columns(judgements: pa.Table) -> dict[str, float]:
    """Return the mean IoU of each lifting, with its interval if there are several clips."""
    columns: dict[str, float] = {}
    for lifting, scores in clip_scores(judgements).items():
        name = COLUMNS[lifting]
        columns[f"{name}_iou"] = float(np.mean(scores))
        if len(scores) > 1:
            columns[f"{name}_low"], columns[f"{name}_high"] = interval_of_mean(np.array(scores))
    return columns


def summaries(history: pa.Table) -> list[dict[str, str]]:
    """Return the last :data:`LISTED` rows as texts by heading, the latest first."""
    listed = []
    for row in reversed(history.to_pylist()[-LISTED:]):
        ious = {f"IoU {name}": row[f"{name}_iou"] for name in COLUMNS.values()}
        texts = {name: "" if iou is None else f"{iou:.4f}" for name, iou in ious.items()}
        counts = {name: row[name] for name in ("version", "in_use", "lessons", "clips", "places")}
        texts |= {name.replace("_", " "): "" if n is None else str(n) for name, n in counts.items()}
        texts["drift beyond noise"] = ""
        if row["against"]:
            texts["drift beyond noise"] = ", ".join(find_drifts(row)) or "none"
        listed.append({"ended": row["ended"], "outcome": row["outcome"], **texts})
    return listed
