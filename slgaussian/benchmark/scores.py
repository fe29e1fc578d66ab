"""Aggregation of samples, rows of the spec ``samples``, to scores, intervals and differences.

Scores are averaged as in LangSplat: over the samples of a scene, then unweighted over scenes. mIoU
and accuracy are averaged as in 3D-OVS: over the classes of a frame, over the frames of a scene,
over scenes. The bootstrap resamples scenes; with one scene there is no interval. If several scenes
(pairs of views) show one place, places are resampled, and then scenes within them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from sys import intern
from typing import Any, NamedTuple, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

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
"""Columns of the samples by which scores are group_rows."""

GOOD_IOU = 0.5
"""Smallest IoU of an answer that is not a miss."""

BATCH = 1000
"""Number of rows that are mappings at once."""

ONE_PLACE = "one place: no interval"
FEW_PLACES = f"fewer than {MIN_SAMPLES} places: a rough interval"


class Rows(Sequence[Row]):
    """Rows of a table, a mapping each: kept as columns, which take a tenth of the memory."""

    def __init__(self, table: pa.Table) -> None:
        self.table = table

    @classmethod
    def from_rows(cls, rows: Iterable[Row], spec: str = "samples") -> Self:
        """Keep rows of a spec, of which :data:`BATCH` are mappings; missing columns are null."""
        schema, unread = load_spec(spec).schema, iter(rows)
        batches = iter(lambda: list(islice(unread, BATCH)), [])
        tables = (pa.Table.from_pylist(batch, schema=schema) for batch in batches)
        return cls(pa.concat_tables([schema.empty_table(), *tables]).combine_chunks())

    @classmethod
    def join(cls, parts: Iterable[Sequence[Row]], spec: str = "samples") -> Self:
        """Return the rows of all parts, which are of a spec, in their order."""
        columns = (part if isinstance(part, Rows) else cls.from_rows(part, spec) for part in parts)
        empty = load_spec(spec).schema.empty_table()
        return cls(pa.concat_tables([empty, *(part.table for part in columns)]).combine_chunks())

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __iter__(self) -> Iterator[Row]:
        batches = self.table.to_batches(max_chunksize=BATCH)
        return chain.from_iterable(map(pa.RecordBatch.to_pylist, batches))

    def __getitem__(self, index: Any) -> Any:
        return self.table.slice(index, 1).to_pylist()[0]

    def values(self, column: str) -> list[Any]:
        """Return the different values of a column, in order of appearance."""
        return list(self.table[column].unique().to_pylist())

    def where(self, **values: str) -> Self:
        """Return the rows with these values in the columns of these names."""
        table = self.table
        for column, value in values.items():
            table = table.filter(pc.equal(table[column], value))
        return type(self)(table)

    def having(self, column: str) -> Self:
        """Return the rows with a value in a column."""
        return type(self)(self.table.filter(pc.is_valid(self.table[column])))

    @property
    def leading(self) -> Self:
        """Return the rows with the protocol of the first row."""
        return self.where(protocol=self.values("protocol")[0]) if len(self) else self


def query_key(row: Row) -> tuple[str, str, str]:
    """Return the identity of a query: scene, frame and query."""
    return row["scene"], row["frame"], row["query"]


def sample_key(row: Row) -> tuple[Any, ...]:
    """Return the key that comparable samples share: scene, frame, query, protocol and size."""
    return row["dataset"], row["protocol"], row["height"], row["width"], *query_key(row)


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


class _Sample(NamedTuple):
    """A sample, and its numbers by metric; texts are shared, as a run has many samples."""

    scene: str
    frame: str
    place: str
    numbers: tuple[float | None, ...]


def _sample(row: Row) -> _Sample:
    values = (row[column] for column in METRICS.values())
    numbers = tuple(None if value is None else float(value) for value in values)
    return _Sample(intern(row["scene"]), intern(row["frame"]), intern(find_place(row)), numbers)


def find_place(row: Row) -> str:
    """Return the place of a sample, or its scene if the data name no place."""
    return row.get("place") or row["scene"]


def scene_means(rows: Iterable[Row]) -> dict[str, float]:
    """Compute the score of each metric from samples of one scene by one method and protocol."""
    samples = list(map(_sample, rows))
    means = {metric: _means(samples, k, metric) for k, metric in enumerate(METRICS)}
    return {metric: mean for metric, by_scene in means.items() for mean in by_scene.values()}


def _means(samples: Iterable[_Sample], k: int, metric: str) -> dict[str, float]:
    """Compute the mean of metric ``k`` of each scene, over its samples that have a number."""
    scenes: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for sample in samples:
        if (number := sample.numbers[k]) is not None:
            scenes[sample.scene][sample.frame if metric in FRAME_METRICS else ""].append(number)
    return {
        scene: float(np.mean([np.mean(numbers) for numbers in frames.values()]))
        for scene, frames in scenes.items()
    }


def score_table(rows: Iterable[Row]) -> pa.Table:
    """Compute the table of spec ``scores`` from samples, by data set, method and protocol.

    Raises:
        InputError: If samples of one method and protocol have different settings.
    """
    groups: dict[tuple[str, ...], list[_Sample]] = defaultdict(list)
    settings: dict[tuple[str, ...], set[tuple[Any, ...]]] = defaultdict(set)
    for row in rows:
        names = tuple(row[column] for column in GROUP_COLUMNS)
        groups[names].append(_sample(row))
        settings[names].add(tuple(row[column] for column in (*SETTING_COLUMNS, "filter")))
    table: list[dict[str, Any]] = []
    for names, samples in groups.items():
        common: dict[str, Any] = dict(zip(GROUP_COLUMNS, names, strict=True))
        common |= {"level": CONFIDENCE_LEVEL} | _settings(common, settings[names])
        place_of_scene = {sample.scene: sample.place for sample in samples}
        for k, metric in enumerate(METRICS):
            if not (means := _means(samples, k, metric)):
                continue
            values, places = np.array([*means.values()]), [place_of_scene[s] for s in means]
            row = common | {"metric": metric, "value": float(values.mean()), "note": ONE_PLACE}
            row |= {"scenes": len(places), "places": len(set(places))}
            row["samples"] = sum(sample.numbers[k] is not None for sample in samples)
            if row["places"] > 1:
                row["low"], row["high"] = interval_of_mean(values, places)
                row["note"] = FEW_PLACES if row["places"] < MIN_SAMPLES else ""
            table.append(row)
    return pa.Table.from_pylist(table, schema=load_spec("scores").schema)


def _settings(names: Row, settings: set[tuple[Any, ...]]) -> dict[str, Any]:
    """Return the settings of all samples of a method and protocol, which must be equal."""
    *columns, filters = map(set, zip(*settings, strict=True))
    for name, values in zip(SETTING_COLUMNS, columns, strict=True):
        if len(values) > 1:
            raise InputError(
                f"scores of {names['method']} by {names['protocol']}: samples were made with "
                f"{name} {', '.join(sorted(map(str, values)))}; score those of one setting, or "
                "call the method differently"
            )
    used = dict(zip(SETTING_COLUMNS, (value for (value,) in columns), strict=True))
    return used | {"filter": ", ".join(map(str, sorted(filters - {None}))) or None}


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
    mine, theirs = map(_by_key, (rows, baseline))
    groups: dict[tuple[str, str], list[tuple[_Sample, _Sample]]] = defaultdict(list)
    for key in mine:
        if key in theirs:
            groups[key[0], key[1]].append((mine[key], theirs[key]))
    gains = []
    for (dataset, protocol), pairs in groups.items():
        for k, metric in enumerate(METRICS):
            shared = [(a, b) for a, b in pairs if None not in (a.numbers[k], b.numbers[k])]
            if not shared:
                continue
            first, second = (_means(side, k, metric) for side in zip(*shared, strict=True))
            place_of_scene = {sample.scene: sample.place for sample, _ in shared}
            places = [place_of_scene[scene] for scene in first]
            gain = compare([*first.values()], [*second.values()], places)
            gains.append(Difference(dataset, protocol, metric, gain, len(shared)))
    return gains


def _by_key(rows: Iterable[Row]) -> dict[tuple[Any, ...], _Sample]:
    samples: dict[tuple[Any, ...], _Sample] = {}
    for row in rows:
        key = sample_key(row)
        if key in samples:
            raise InputError(
                f"differences: {row['query']!r} in {row['frame']!r} of scene {row['scene']!r} is "
                f"there twice by {row['protocol']}; give the samples of one method of one run"
            )
        samples[key] = _sample(row)
    return samples


def group_rows(rows: Iterable[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Group rows by some of their columns, in order of appearance."""
    groups: dict[tuple[Any, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[tuple(row[name] for name in names)].append(row)
    return dict(groups)
