"""Run many scenes, each a chain of stages, as one Prefect flow that a bad scene cannot stop."""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pyarrow as pa
from prefect import Task
from prefect.futures import PrefectFuture

from data_specs import load_spec
from flows.progress import Progress
from slgaussian.errors import SLGaussianError
from slgaussian.store import ArtifactRef, DamagedError
from tasks.stage import StageCall


@dataclass(frozen=True)
class Step:
    """One stage of a chain.

    ``inputs`` maps the name that the stage knows an input by to the stage that makes it, or to a
    ref that the chain was given.
    """

    stage: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)
    package: str = "tasks"

    def call(self, refs: Mapping[str, ArtifactRef], scene: str, workers: int) -> StageCall:
        """The work to submit, its key computed so that an unkeyable setting fails here."""
        module = f"{self.package}.{self.stage}"
        inputs = {name: refs[source] for name, source in self.inputs.items()}
        call = StageCall(module, self.settings, inputs, self.where, scene, workers)
        call.key  # noqa: B018
        return call


@dataclass
class Chain:
    """The stages of one scene, and the refs made so far by stage.

    ``plan`` lists the steps; it is asked when the chain's turn comes, as it reads files to hash
    them. ``first`` names the stage that an error in the plan belongs to.
    """

    scene: str
    plan: Callable[[], Sequence[Step]]
    refs: dict[str, ArtifactRef] = field(default_factory=dict)
    first: str = "ingest"
    steps: Sequence[Step] = ()
    position: int = 0
    remade: set[str] = field(default_factory=set)

    @property
    def stage(self) -> str:
        """The stage that is being worked on."""
        return self.steps[self.position].stage if self.steps else self.first

    def go_back(self, uri: str) -> int:
        """Return to the stage that made a damaged artifact, once for each of them.

        How many stages back that is; 0 if no stage made it, or it was damaged before.
        """
        for position, step in enumerate(self.steps[: self.position]):
            ref = self.refs[step.stage]
            if uri in (ref.uri, *ref.meta.get("parts", ())) and uri not in self.remade:
                self.remade.add(uri)
                back, self.position = self.position - position, position
                return back
        return 0


@dataclass(frozen=True)
class Failure:
    """A scene that was left out: where, what kind of error, and one sentence why."""

    scene: str
    stage: str
    kind: str
    reason: str


@dataclass
class Outcome:
    """What a run made: refs by scene and stage of the scenes that went through, and the others."""

    refs: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)


def run_chains(task: Task, chains: Iterable[Chain], workers: int, progress: Progress) -> Outcome:
    """Run the chains, at most ``workers`` at a time, to be called inside a flow.

    A chain keeps its place until it ends: the first scenes are complete early, and no more than
    ``workers`` scenes are in memory. An error takes only its own chain out.
    """
    waiting, outcome = deque(chains), Outcome()
    finished: queue.SimpleQueue[tuple[Chain, float, PrefectFuture]] = queue.SimpleQueue()
    running = 0

    def submit(chain: Chain) -> bool:
        """Submit the chain's next step; False if there is none or it cannot be submitted."""
        try:
            if not chain.steps:
                chain.steps = chain.plan()
            if chain.position == len(chain.steps):
                outcome.refs[chain.scene] = chain.refs
                return False
            call = chain.steps[chain.position].call(chain.refs, chain.scene, workers)
        except SLGaussianError as error:
            fail(chain, error)
            return False
        start = time.perf_counter()
        progress.started(chain.scene, chain.stage)
        future = task.with_options(name=chain.stage).submit(call)
        future.add_done_callback(lambda done: finished.put((chain, start, done)))
        return True

    def fail(chain: Chain, error: BaseException) -> None:
        reason = " ".join(str(error).split()) or type(error).__name__
        if not isinstance(error, SLGaussianError):
            reason = f"unexpected {type(error).__name__}: {reason}"
        failure = Failure(chain.scene, chain.stage, type(error).__name__, reason)
        outcome.failures.append(failure)
        progress.failed(chain.scene, chain.stage, reason, error)

    while waiting or running:
        while waiting and running < workers:
            running += submit(waiting.popleft())
        if not running:
            continue
        chain, start, future = finished.get()
        future.wait()  # done already; this is how the future takes its final state
        state = future.state
        result = state.result(raise_on_failure=False)
        if isinstance(result, ArtifactRef):
            seconds = time.perf_counter() - start
            progress.finished(chain.scene, chain.stage, seconds, cached=state.name == "Cached")
            chain.refs[chain.stage] = result
            chain.position += 1
            running -= not submit(chain)
        elif isinstance(result, DamagedError) and (back := chain.go_back(result.uri)):
            progress.went_back(chain.scene, back, str(result))
            running -= not submit(chain)
        else:
            fail(chain, result)
            running -= 1
    outcome.failures.sort(key=lambda failure: failure.scene)
    return outcome


def failures_table(failures: Sequence[Failure]) -> pa.Table:
    """The failures as a table of spec ``failures``."""
    rows = [vars(failure) for failure in failures]
    return pa.Table.from_pylist(rows, schema=load_spec("failures").schema)
