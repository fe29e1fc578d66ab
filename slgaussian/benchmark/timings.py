"""How long a query takes: what is true of one run on one machine, kept apart from the scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any

from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.paper_tables import SECONDS
from slgaussian.storage.specs import load_spec

if TYPE_CHECKING:  # what measures them takes long to load
    from slgaussian.benchmark.numerics import HardCase


@dataclass(frozen=True)
class StageCost:
    """What a stage cost, whenever its artifacts were made.

    Attributes
    ----------
    seconds : float
        Of all artifacts together, without compiling kernels.
    middle : float
        Of one: the median.
    grown : int or None
        Bytes by which memory grew, at most, beyond what was held before; None where not known.
    compiling : float
        Seconds of compiling kernels, once an installation, on top.
    """

    seconds: float
    middle: float
    grown: int | None = None
    compiling: float = 0.0

    @staticmethod
    def of(metas: Iterable[Mapping[str, Any]]) -> StageCost:
        """Of what artifacts say of themselves; earlier versions wrote only ``seconds``."""
        known = list(metas)
        seconds = [meta["seconds"] for meta in known]
        grown = [meta["grown"] for meta in known if meta.get("grown") is not None]
        return StageCost(
            sum(seconds),
            median(seconds) if seconds else 0.0,
            max(grown, default=None),
            sum(meta.get("compiling", 0.0) for meta in known),
        )


@dataclass(frozen=True)
class Times:
    """Seconds of a run.

    Attributes
    ----------
    stages : {stage: StageCost}
    answers : sequence of (method, scene, {name: float})
        What :func:`slgaussian.benchmark.evaluate.evaluate` measured, and ``prepare`` where a
        method prepares a scene on top of what it shares with ours.
    host : {name: text}
        Where it ran.
    machines : {processor: int}
        How many of the artifacts were made on which processor; earlier runs may have made some
        elsewhere.
    costs : sequence of Cost
        Of each method on each data set.
    hard_cases : sequence of HardCase
        What the machine makes of them.
    """

    stages: Mapping[str, StageCost]
    answers: Sequence[tuple[str, str, Mapping[str, float]]]
    host: Mapping[str, str]
    machines: Mapping[str, int] = field(default_factory=dict)
    costs: Sequence[Cost] = ()
    hard_cases: Sequence[HardCase] = ()

    def as_json(self) -> dict[str, Any]:
        """Plain data, for a file."""
        return {
            "spec": load_spec("run_times").label,
            "seconds_by_stage": {name: one.seconds for name, one in self.stages.items()},
            "memory_by_stage": {name: one.grown for name, one in self.stages.items()},
            "seconds_of_compiling": self.compiling,
            "seconds_a_query": [asdict(speed) for speed in self.speeds()],
            "seconds_by_answer": [
                {"method": method, "scene": scene, **dict(sorted(times.items()))}
                for method, scene, times in self.answers
            ],
            "host": dict(self.host),
            "artifacts_by_machine": dict(self.machines),
            "hard_cases": [{**asdict(case), "good": case.good} for case in self.hard_cases],
        }

    @property
    def compiling(self) -> float:
        """Seconds of compiling kernels, once an installation, that no other number here has."""
        return sum(one.compiling for one in self.stages.values())

    @property
    def broken(self) -> list[HardCase]:
        """The hard cases that are not good."""
        return [case for case in self.hard_cases if not case.good]

    def speeds(self) -> list[Speed]:
        """One a method, in the order of the answers."""
        methods = dict.fromkeys(method for method, *_ in self.answers)
        return [self._speed(method) for method in methods]

    def claim(self) -> str:
        """What the paper claims of speed, and what was measured; empty without its two methods."""
        known = sorted(
            (one.paper, one.method, one.first_query)
            for one in self.speeds()
            if one.first_query is not None and one.paper is not None
        )
        if len(known) < 2:
            return ""
        (fast_paper, fast, fast_query), (slow_paper, slow, slow_query) = known
        if not fast_query:
            return ""
        return (
            f"A query in a new view takes {slow} {slow_query / fast_query:.0f} times as long as "
            f"{fast}, {slow_query:.2g} s against {fast_query:.2g} s; the paper says "
            f"{slow_paper:g} s against {fast_paper:g} s, on its GPU and with its networks."
        )

    def _speed(self, method: str) -> Speed:
        def middle(name: str) -> float | None:
            own = [times.get(name) for by, _, times in self.answers if by == method]
            known = [value for value in own if value is not None]
            return median(known) if known else None

        return Speed(
            method,
            prepare=middle("prepare"),
            cold_query=middle("cold_query"),
            first_query=middle("first_query"),
            further_query=middle("further_query"),
            paper=SECONDS.get(method),
        )


@dataclass(frozen=True)
class Speed:
    """Seconds of a method, medians over scenes; None where it was not measured.

    Attributes
    ----------
    method : str
    prepare : float or None
        Of a scene, on top of what all methods share.
    cold_query : float or None
        The very first of a scene, with all that is done once a process, as loading models.
    first_query : float or None
        In a view that was not seen before, its rendering included.
    further_query : float or None
        One more text in the same view.
    paper : float or None
        What the paper says of a query in a new view, on its GPU.
    """

    method: str
    prepare: float | None
    cold_query: float | None
    first_query: float | None
    further_query: float | None
    paper: float | None
