"""Aggregation of samples, rows of the spec ``samples``, to scores, intervals and differences.

Scores are averaged as in LangSplat: over the samples of a scene, then unweighted over scenes. mIoU
and accuracy are averaged as in 3D-OVS: over the classes of a frame, over the frames of a scene,
over scenes. The bootstrap resamples scenes; with one scene there is no interval. If several scenes
(pairs of views) show one place, places are resampled, and then scenes within them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.statistics import (
    CONFIDENCE_LEVEL,
    MIN_SAMPLES,
    Comparison,
    compare,
    interval_of_mean,
)
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec

Row = Mapping[str, Any]

SETTING_COLUMNS = ("selection", "temperature", "threshold", "share", "canonical", "absent")
"""Columns of the samples that must be equal in all samples of a score."""

GROUP_COLUMNS = ("dataset", "method", "protocol")
"""Columns of the samples by which scores are grouped."""

GOOD_IOU = 0.5
"""Smallest IoU of an answer that is not a miss."""

ONE_PLACE = "one place: no interval"
FEW_PLACES = f"fewer than {MIN_SAMPLES} places: a rough interval"


def key_of(row: Row) -> tuple[str, str, str]:
    """Return the identity of a query: scene, frame and query."""
    return row["scene"], row["frame"], row["query"]


def sample_key(row: Row) -> tuple[Any, ...]:
    """Return the key that comparable samples share: scene, frame, query, protocol and size."""
    return row["dataset"], row["protocol"], row["height"], row["width"], *key_of(row)


def of_first_protocol(rows: Sequence[Row]) -> list[Row]:
    """Return the samples with the protocol of the first sample."""
    return [row for row in rows if row["protocol"] == rows[0]["protocol"]]


METRICS = {
    "iou": "iou",
    "boundary_iou": "boundary_iou",
    "miou": "class_iou",
    "accuracy": "accuracy",
    "hit_mask": "hit_mask",
    "hit_box": "hit_box",
    "hit_peak": "hit_peak",
}
"""Column of the samples of each metric; the protocol of a row determines which of them it has."""

FRAME_METRICS = ("miou", "accuracy")
"""Metrics that are averaged over the samples of a frame first."""


def scene_means(rows: Iterable[Row]) -> dict[str, float]:
    """Return the scores of one scene, method and protocol by name, without those of no sample."""
    rows = list(rows)
    present = {name: _with_value(rows, column) for name, column in METRICS.items()}
    return {metric: _mean(samples, metric) for metric, samples in present.items() if samples}


def score_table(rows: Iterable[Row]) -> pa.Table:
    """Compute the table of spec ``scores`` from samples, by data set, method and protocol.

    Raises:
        InputError: If samples of one method and protocol have different settings.
    """
    table: list[dict[str, Any]] = []
    for names, group in grouped(rows, *GROUP_COLUMNS).items():
        common = {
            **dict(zip(GROUP_COLUMNS, names, strict=True)),
            "level": CONFIDENCE_LEVEL,
            **_settings(group),
        }
        for metric, column in METRICS.items():
            samples = _with_value(group, column)
            if not samples:
                continue
            scenes = grouped(samples, "scene").values()
            values = np.array([_mean(scene, metric) for scene in scenes])
            places = [place_of(scene[0]) for scene in scenes]
            row = common | {"metric": metric, "value": float(values.mean()), "note": ONE_PLACE}
            row |= {"scenes": len(places), "places": len(set(places)), "samples": len(samples)}
            if row["places"] > 1:
                row["low"], row["high"] = interval_of_mean(values, places)
                row["note"] = FEW_PLACES if row["places"] < MIN_SAMPLES else ""
            table.append(row)
    return pa.Table.from_pylist(table, schema=load_spec("scores").schema)


@dataclass(frozen=True)
class Difference:
    """Difference of two methods in one protocol and metric.

    Attributes:
        gain: Comparison over scenes; its interval is meaningless if all scenes show one place.
        samples: Number of samples that both have.
    """

    dataset: str
    protocol: str
    metric: str
    gain: Comparison
    samples: int


def differences(rows: Iterable[Row], baseline: Iterable[Row]) -> list[Difference]:
    """Compute paired differences of two methods or two runs: ``rows`` minus ``baseline``.

    Only common samples are used (:func:`sample_key`); settings may differ. Scenes are resampled in
    pairs.

    Raises:
        InputError: If one of them has a sample twice, for example samples of two methods.
    """
    mine, theirs = (_by_sample(table) for table in (rows, baseline))
    pairs = [(mine[key], theirs[key]) for key in mine if key in theirs]
    gains = []
    groups = grouped(pairs, "dataset", "protocol", row_of=itemgetter(0))
    for (dataset, protocol), group in groups.items():
        for metric, column in METRICS.items():
            shared = [p for p in group if p[0][column] is not None and p[1][column] is not None]
            if not shared:
                continue
            scenes = grouped(shared, "scene", row_of=itemgetter(0)).values()
            first, second = (
                [_mean([pair[side] for pair in scene], metric) for scene in scenes]
                for side in (0, 1)
            )
            gain = compare(first, second, [place_of(scene[0][0]) for scene in scenes])
            gains.append(Difference(dataset, protocol, metric, gain, len(shared)))
    return gains


def place_of(row: Row) -> str:
    """Return the place of a sample, or its scene if the data name no place."""
    return row.get("place") or row["scene"]


def _with_value(rows: Iterable[Row], column: str) -> list[Row]:
    return [row for row in rows if row[column] is not None]


def _mean(rows: Sequence[Row], metric: str) -> float:
    """Compute the mean of a metric over samples of one scene, all of which have it."""
    frames = grouped(rows, "frame").values() if metric in FRAME_METRICS else [rows]
    means = [np.mean([float(row[METRICS[metric]]) for row in frame]) for frame in frames]
    return float(np.mean(means))


def _settings(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the settings of all samples of a method and protocol, which must be equal."""
    for name in SETTING_COLUMNS:
        values = {row[name] for row in rows}
        if len(values) > 1:
            listed = ", ".join(sorted(map(str, values)))
            raise InputError(
                f"scores of {rows[0]['method']} by {rows[0]['protocol']}: samples were made with "
                f"{name} {listed}; score those of one setting, or call the method differently"
            )
    filters = sorted({row["filter"] for row in rows} - {None})
    return {name: rows[0][name] for name in SETTING_COLUMNS} | {
        "filter": ", ".join(map(str, filters)) or None
    }


def _by_sample(rows: Iterable[Row]) -> dict[tuple[Any, ...], Row]:
    keyed: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = sample_key(row)
        if key in keyed:
            raise InputError(
                f"differences: {row['query']!r} in {row['frame']!r} of scene {row['scene']!r} is "
                f"there twice by {row['protocol']}; give the samples of one method of one run"
            )
        keyed[key] = row
    return keyed


def grouped(
    rows: Iterable[Any], *names: str, row_of: Callable[[Any], Row] = lambda row: row
) -> dict[tuple[Any, ...], list[Any]]:
    """Group rows by some of their columns, in order of appearance.

    ``row_of`` returns the row of an item of ``rows``.
    """
    groups: dict[tuple[Any, ...], list[Any]] = defaultdict(list)
    for row in rows:
        groups[tuple(row_of(row)[name] for name in names)].append(row)
    return dict(groups)
