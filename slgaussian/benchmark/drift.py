"""Drift of lessons: whether those of a corpus differ from those of an earlier version.

Two versions of a corpus share most of their clips, and lessons of one clip are alike. So clips, not
lessons, are resampled, and a clip of both versions is resampled in both.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.statistics import CONFIDENCE_LEVEL, interval
from slgaussian.kernels.seeding import rng_for
from slgaussian.storage.specs import load_spec

RESAMPLINGS = 1000
"""Number of resamplings of the clips for an interval, and of exchanges for the noise."""

GRID = 256
"""Largest number of values at which two distributions are compared: quantiles of both."""

ROUNDING = 1e-9
"""Tolerance of distances: one is beyond noise if it is larger by more than this."""

LISTS = (
    "quantities",
    "medians_then",
    "medians_now",
    "drifts",
    "drift_lows",
    "drift_highs",
    "noises",
)
"""Columns of spec ``history`` on drift."""

DIGITS = 16
"""Hexadecimal digits by which a clip is recognised."""


def lesson_distributions(lessons: pa.Table, pairs: pa.Table, version: int) -> pa.Table:
    """Return a table of spec ``distributions``, a row per lesson, of tables of their specs."""
    spec = load_spec("distributions")
    pairs = pairs.select(["sample", "overlap", "baseline", "depth", "blur", "clipped"])
    rows = lessons.drop_columns(["chunk"]).join(pairs, "sample").sort_by("sample").to_pylist()
    for row in rows:
        row["version"], row["shared"] = version, row["shared"] / max(1, row["objects"])
        row["clip"] = hashlib.sha256(row["clip"].encode()).hexdigest()[:DIGITS]
    return pa.Table.from_pylist(rows, schema=spec.schema)


def compare_lessons(then: pa.Table, now: pa.Table) -> dict[str, list[Any]]:
    """Compare each quantity of two tables of spec ``distributions``.

    The distance is that of Kolmogorov and Smirnov, its interval from a Bayesian bootstrap over
    clips (Rubin 1981). The noise is the distance that a random exchange of clips between the
    versions exceeds with a chance of 5 % for all quantities together (Bonferroni).

    Returns:
        The columns of spec ``history`` on drift.
    """
    named = then["clip"].to_pylist() + now["clip"].to_pylist()
    clips, numbers = np.unique(named, return_inverse=True)
    sides = numbers[: then.num_rows], numbers[then.num_rows :]
    present = [np.isin(np.arange(len(clips)), side).astype(float) for side in sides]
    names = [name for name in now.column_names if name not in ("version", "clip")]
    level = 1 - (1 - CONFIDENCE_LEVEL) / len(names)
    rows = []
    for name in names:
        rng = rng_for(0, name, "drift of lessons")
        values = [table[name].to_numpy() for table in (then, now)]
        ranks = np.linspace(0, 1, GRID)
        grid = np.unique(np.quantile(np.concatenate(values), ranks, method="nearest"))
        counts = [np.zeros((len(clips), len(grid))) for _ in sides]  # lessons up to a value
        for table, side, column in zip(counts, sides, values, strict=True):
            np.add.at(table, side, column[:, None] <= grid)
        draws = (rng.exponential(size=len(clips)) for _ in range(RESAMPLINGS))
        low, high = interval(np.array([_distance(counts, (draw, draw)) for draw in draws]))
        # In an exchange a clip has its present lessons or, if it is gone, its last ones.
        latest = np.where(present[1][:, None] > 0, counts[1], counts[0])
        orders = (rng.permutation(len(clips)) for _ in range(RESAMPLINGS))
        chance = [
            _distance((latest, latest), [side[order] for side in present]) for order in orders
        ]
        medians = (float(np.median(column)) for column in values)
        noise = float(np.quantile(chance, level))
        rows.append((name, *medians, _distance(counts, present), low, high, noise))
    columns = map(list, zip(*rows, strict=True))
    return dict(zip(LISTS, columns, strict=True))


def find_drifts(row: dict[str, Any]) -> list[str]:
    """Return the quantities of a row of spec ``history`` whose drift is beyond noise."""
    drifts = zip(row["quantities"], row["drifts"], row["noises"], strict=True)
    return [name for name, drift, noise in drifts if drift > noise + ROUNDING]


def _distance(counts: Any, weights: Any) -> float:
    """Return the distance of two sides, of counts [C, G] and weights [C] of the clips of each."""
    totals = [weight @ table for weight, table in zip(weights, counts, strict=True)]
    first, second = (total / total[-1] for total in totals)
    return min(1.0, float(np.abs(first - second).max()))
