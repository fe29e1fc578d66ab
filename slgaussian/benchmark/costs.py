"""Costs of answers, stages and runs, separate from the scores: not reproducible from run to run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from slgaussian.storage.specs import load_spec

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Cost:
    """Cost of a method on a data set; None if not measured.

    Attributes:
        view_query, further_query: Seconds of the first query in a view, with its rendering, and of
            a further query in it, both without what is computed once per scene: medians over views
            and queries.
        prepare, build: Seconds per scene for the method, and for the field that all methods share:
            medians over scenes.
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
        """Return the seconds from photographs to an answer in a new view."""
        if self.build is None or self.view_query is None:
            return None
        return self.build + self.view_query


def costs_of(rows: Iterable[Row]) -> list[Cost]:
    """Return one cost per data set and method from rows of the spec ``times``, in their order.

    Rows may lack unknown columns.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["dataset"], row["method"]), []).append(row)
    return [_cost(*names, members) for names, members in groups.items()]


def _cost(dataset: str, method: str, rows: Sequence[Row]) -> Cost:
    frames = list({(row["scene"], row["frame"]): row for row in rows}.values())
    scenes = list({row["scene"]: row for row in rows}.values())
    peaks = [row["peak_bytes"] for row in scenes if row.get("peak_bytes") is not None]
    return Cost(
        dataset,
        method,
        view_query=_median(row.get("view_seconds") for row in frames),
        further_query=_median(row.get("query_seconds") for row in rows),
        prepare=_median(row.get("prepare_seconds") for row in scenes),
        build=_median(row.get("build_seconds") for row in scenes),
        peak=max(peaks, default=None),
    )


def _median(values: Iterable[float | None]) -> float | None:
    measured = [value for value in values if value is not None]
    return median(measured) if measured else None


@dataclass(frozen=True)
class StageCost:
    """Cost of a stage, measured when its artifacts were computed.

    Attributes:
        seconds: Total of all artifacts, without compiling kernels.
        middle: Median over artifacts.
        peak: Largest memory of the process until their end, bytes; None if unknown.
        compiling: Additional seconds for compiling kernels, once per installation.
    """

    seconds: float
    middle: float
    peak: int | None = None
    compiling: float = 0.0

    @staticmethod
    def of(metas: Iterable[Row]) -> StageCost:
        """Summarise the metadata of artifacts."""
        artifacts = list(metas)
        seconds = [meta["seconds"] for meta in artifacts]
        peaks = [meta["peak"] for meta in artifacts if meta.get("peak") is not None]
        return StageCost(
            sum(seconds),
            median(seconds) if seconds else 0.0,
            max(peaks, default=None),
            sum(meta["compiling"] for meta in artifacts),
        )


@dataclass(frozen=True)
class Times:
    """Seconds of a run.

    Attributes:
        stages: {stage: StageCost}
        host: {name: text}. Description of the machine.
        costs: sequence of Cost. Costs of each method on each data set.
        paper: Name of the method that is compared with the paper's costs; "" for none.
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
            "memory_by_stage": {name: cost.peak for name, cost in self.stages.items()},
            "seconds_of_compiling": self.compiling,
            "host": dict(self.host),
        }

    @property
    def compiling(self) -> float:
        """Return the seconds of compiling kernels, which no other number includes."""
        return sum(cost.compiling for cost in self.stages.values())
