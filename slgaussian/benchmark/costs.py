"""Costs of answers, stages and runs, separate from the scores: not reproducible from run to run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import pyarrow.compute as pc

from slgaussian.benchmark.scores import Rows
from slgaussian.storage.specs import load_spec

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Cost:
    """Cost of a method on a data set; None if not measured.

    Attributes:
        view_query, further_query: Median seconds of the first query in a view, with its rendering,
            and of a further query in it, both without what is computed once per scene.
        prepare, build: Median seconds per scene for the method, and for the field that all methods
            share.
        peak: Largest memory of the process, bytes.
    """

    dataset: str
    method: str
    view_query: float | None = None
    further_query: float | None = None
    prepare: float | None = None
    build: float | None = None
    peak: int | None = None

    @property
    def total(self) -> float | None:
        """Return the seconds from photographs to a first answer: build, prepare, query."""
        if self.build is None or self.view_query is None:
            return None
        return self.build + (self.prepare or 0.0) + self.view_query


def measure_costs(rows: Rows) -> list[Cost]:
    """Return one cost per data set and method from rows of the spec ``times``, in their order."""
    costs = []
    for dataset in rows.values("dataset"):
        for method in rows.where(dataset=dataset).values("method"):
            answers = rows.where(dataset=dataset, method=method)
            cost = Cost(
                dataset,
                method,
                view_query=_median(answers, "view_seconds", "scene", "frame"),
                further_query=_median(answers, "query_seconds", "scene", "frame", "query"),
                prepare=_median(answers, "prepare_seconds", "scene"),
                build=_median(answers, "build_seconds", "scene"),
                peak=pc.max(answers.table["peak_bytes"]).as_py(),
            )
            costs.append(cost)
    return costs


def _median(rows: Rows, column: str, *unit: str) -> float | None:
    """Return the median of a column over frames, scenes or answers; rows of one have one value."""
    values = {tuple(row[name] for name in unit): row[column] for row in rows.having(column)}
    return median(values.values()) if values else None


@dataclass(frozen=True)
class StageCost:
    """Cost of a stage, measured when its artifacts were computed.

    Attributes:
        seconds, middle: Total of all artifacts, and their median, without compiling kernels.
        compiling: Additional seconds for compiling kernels, once per installation.
    """

    seconds: float
    middle: float
    compiling: float = 0.0

    @staticmethod
    def of(metas: Iterable[Row]) -> StageCost:
        """Summarise the metadata of artifacts."""
        measured = [(meta["seconds"], meta["compiling"]) for meta in metas]
        seconds, compiling = zip(*measured, strict=True) if measured else ((0.0,), (0.0,))
        return StageCost(sum(seconds), median(seconds), sum(compiling))


@dataclass(frozen=True)
class Times:
    """Seconds of a run.

    ``host`` describes the machine; ``paper`` is the name of the method that is compared with the
    paper's costs, "" for none.
    """

    stages: Mapping[str, StageCost]
    host: Mapping[str, str]
    costs: Sequence[Cost] = ()
    paper: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return JSON-compatible data, without the costs of answers (table ``times``)."""
        return {
            "spec": load_spec("run_times").label,
            "seconds_by_stage": {name: cost.seconds for name, cost in self.stages.items()},
            "seconds_of_compiling": self.compiling,
            "host": dict(self.host),
        }

    @property
    def compiling(self) -> float:
        """Return the seconds of compiling kernels, which no other number includes."""
        return sum(cost.compiling for cost in self.stages.values())
