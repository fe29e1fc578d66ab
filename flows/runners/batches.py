"""Batches of scenes: the Prefect task of a worker, and the loop that submits batches.

A worker is a thread, a process or another machine, so arguments and results are small and
picklable; large data go through the store. A scene, or a chunk of a corpus, is the unit of failure:
an error excludes only its own scene. After the death of a worker the scenes of its batch are
retried one at a time, and a scene whose worker dies again is left out.
"""

from __future__ import annotations

import pickle
import queue
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import pyarrow as pa
from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.futures import PrefectFuture
from prefect.states import Cancelled, Completed, Failed, State
from prefect.task_runners import TaskRunner

from flows.runners.progress import Progress
from flows.runners.task_runners import Workers, last_line
from slgaussian.errors import SLGaussianError
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore, DamagedError, StoreError
from tasks.context import Notify, RunContext, StageEvent, enclosing_run, run_context

Result = TypeVar("Result")

MAX_BATCH = 16
"""Largest number of scenes of a batch: with all stages cached a batch takes a second."""

MIN_FAILURES = 20
"""Number of scenes that may be left out, whatever share of the scenes that is."""

MAX_NAMED = 50
"""Largest number of scenes in the message of a state."""

FAILURES = "failures.parquet"
"""Table of the scenes that a run left out."""

DEAD_WORKER_ERRORS = {
    "BrokenProcessPool",
    "KilledWorker",
    "NodeDiedError",
    "OutOfMemoryError",
    "WorkerCrashedError",
}
"""Names of the errors by which task runners report a dead worker; a worker raised any other."""


@dataclass(frozen=True)
class SceneTask:
    """A scene, or a chunk, with its pipeline.

    Attributes:
        pipeline: A module-level function that calls the stages, with ``arguments``.
        first: The stage to which an error before the first stage is attributed.
    """

    scene: str
    pipeline: Callable[..., object]
    arguments: tuple[Any, ...] = ()
    first: str = "ingest"


@dataclass(frozen=True)
class Failure:
    """A scene that was left out: the stage, the kind of error, and its message."""

    scene: str
    stage: str
    kind: str
    reason: str


@dataclass
class SceneResult:
    """Result of a scene from a worker.

    Attributes:
        refs: Results of all stages, or of those before the one that failed.
        events: Events of a worker in another process.
    """

    scene: str
    refs: dict[str, ArtifactRef]
    failure: Failure | None = None
    events: list[StageEvent] = field(default_factory=list)


@dataclass
class Outcome:
    """Refs by scene and stage of the completed scenes, and failures of the others.

    ``partial`` has the refs of failed scenes, of the stages before the failure.
    """

    refs: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    partial: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)


class StoppedError(SLGaussianError):
    """Raised in a thread that still computes a scene when the run ends."""


class TooManyFailuresError(SLGaussianError):
    """More scenes were left out than ``max_failures`` allows; ``failures`` has them."""

    def __init__(self, message: str, failures: Sequence[Failure]) -> None:
        super().__init__(message)
        self.failures = failures


def state_after(
    message: str, result: Result, failures: Sequence[Failure], nothing_left: bool
) -> State[Result]:
    """Return the final state of a run or of a batch; its message names failures and a reason.

    Failed if nothing is left, ``LeftOut`` (of type Completed, for alerts) if something was left
    out, else Completed.
    """
    names = list(dict.fromkeys(failure.scene for failure in failures))
    if names:
        rest = f" and {len(names) - MAX_NAMED} more" if names[MAX_NAMED:] else ""
        message += f"{'; ' * bool(message)}left out: {', '.join(names[:MAX_NAMED])}{rest}"
        message += f" ({failures[0].stage}: {failures[0].reason})"
    if nothing_left:
        return Failed(message=message, data=result)
    name = "LeftOut" if names else "Completed"
    return Completed(name=name, message=message or None, data=result)


@task(name="scenes", task_run_name="{label}", cache_policy=NO_CACHE, persist_result=False)
def run_batch(label: str, pickled: bytes) -> State[list[SceneResult]]:
    """Run the pipelines of a batch of scenes sequentially.

    The state is Failed if all were left out, ``LeftOut`` if some were, and ``Cached`` (of type
    Completed) if nothing was computed: stages that are found in the store have no tasks.

    ``pickled`` are the store's root, the scene tasks, the number of workers and the stages to
    recompute. Arguments are pickled for threads too, so that all task runners behave alike. Events
    are sent to the flow if it is in this process. DamagedError if a scene needs a damaged artifact,
    StoreError if the store fails.
    """
    root, scene_tasks, workers, refresh = pickle.loads(pickled)
    store, enclosing = ArtifactStore(root), enclosing_run()
    events: list[StageEvent] = []
    computed: set[str] = set()
    results: list[SceneResult] = []

    def notify(event: StageEvent) -> None:
        if event.state in ("completed", "failed"):
            computed.add(event.scene)
        (events.append if enclosing is None else enclosing.notify)(event)

    for scene_task in scene_tasks:
        events = []
        try:
            result = compute_scene(scene_task, store, workers, notify, refresh)
        except StoppedError:
            return Cancelled(message="the run has ended", data=results)
        results.append(replace(result, events=events))
    message = f"{len(results) - len(computed)} of {len(results)} found in the store"
    if not computed:
        return Completed(name="Cached", message=message, data=results)
    lost = [result.failure for result in results if result.failure is not None]
    return state_after(message, results, lost, len(lost) == len(results))


def compute_scene(
    scene_task: SceneTask,
    store: ArtifactStore,
    workers: int,
    notify: Notify,
    refresh: frozenset[str] = frozenset(),
    look_up: bool = False,
) -> SceneResult:
    """Run the pipeline of a scene, or only look its results up, without any task of Prefect's.

    DamagedError if it needs a damaged artifact, StoreError if the store fails.
    """
    name, first = scene_task.scene, scene_task.first
    run = RunContext(store, name, workers, notify, refresh, look_up, stage=first)
    try:
        with run_context(run):
            scene_task.pipeline(*scene_task.arguments)
        return SceneResult(name, run.refs)
    except (StoppedError, DamagedError, StoreError):
        raise
    except (Exception, SystemExit) as error:  # other scenes continue after any error
        reason, trace = " ".join(str(error).split()) or type(error).__name__, ""
        if not isinstance(error, SLGaussianError):
            reason = f"unexpected {type(error).__name__}: {reason}"
            trace = "".join(traceback.format_exception(error)).rstrip()
        notify(StageEvent(name, run.stage, "failed", reason, traceback=trace))
        return SceneResult(name, run.refs, Failure(name, run.stage, type(error).__name__, reason))


def look_up_scenes(
    scene_tasks: Sequence[SceneTask], store: ArtifactStore, refresh: frozenset[str] = frozenset()
) -> list[SceneResult]:
    """Return the stored results of scenes: a failure names the first stage without one.

    Nothing is computed, and nothing sent to Prefect. DamagedError and StoreError as a scene.
    """

    def find(scene_task: SceneTask) -> SceneResult:
        return compute_scene(scene_task, store, 1, RunContext.notify, refresh, look_up=True)

    return store.map(find, scene_tasks)


def map_scenes(scene_tasks: Sequence[SceneTask], workers: Workers, progress: Progress) -> Outcome:
    """Compute all scene tasks on the workers of a flow, within it; show the progress.

    At most one batch per worker is submitted at a time, each with one scene in memory.

    Raises:
        DamagedError: At the end, if a scene needs a damaged artifact.
        StoreError: At once, if the store fails: each further scene would.
        TooManyFailuresError: If more scenes are left out than ``max_failures`` allows.
        SLGaussianError: If the task runner accepts no more work.
    """
    outcome = Outcome()
    if not scene_tasks:
        return outcome
    config, store, refresh = workers.config, workers.store, frozenset(workers.config.refresh)
    damaged: DamagedError | None = None
    waiting = deque(scene_tasks)
    if config.only_missing:
        stored = look_up_scenes(scene_tasks, store, refresh)
        outcome.refs = {result.scene: result.refs for result in stored if result.failure is None}
        waiting = deque(t for t in waiting if t.scene not in outcome.refs)
        count = f"{len(outcome.refs)} of {len(scene_tasks)}"
        progress.line(f"complete in the store: {count} {progress.unit}")
        progress.scenes, progress.total = len(waiting), len(waiting) * progress.stages
    retried_singly: deque[SceneTask] = deque()
    lost_before: set[str] = set()
    news: queue.SimpleQueue[StageEvent | PrefectFuture[Any]] = queue.SimpleQueue()
    running: dict[PrefectFuture[Any], tuple[list[SceneTask], TaskRunner[Any]]] = {}
    stopped = threading.Event()

    def notify(event: StageEvent) -> None:
        if stopped.is_set() and not event.message:  # between stages, whose tasks thus complete
            raise StoppedError("stopped")
        news.put(event)

    def collect(result: SceneResult) -> None:
        for event in result.events:
            progress.update(event)
        if result.failure is None:
            outcome.refs[result.scene] = result.refs
        else:
            outcome.failures.append(result.failure)
            outcome.partial[result.scene] = result.refs

    def retry(scenes: list[SceneTask], runner: TaskRunner[Any], error: BaseException) -> None:
        died, reason = type(error).__name__ in DEAD_WORKER_ERRORS, last_line(str(error))
        event_text = f"died ({reason})" if died else f"raised {type(error).__name__}: {reason}"
        progress.lost(event_text, [scene_task.scene for scene_task in scenes])
        text = f"its worker {event_text} twice, the second time with no other scene"
        if died:
            text += "; it may need more memory than there is: try it with --workers 1"
            workers.restart(runner)
        for scene_task in scenes:
            scene, stage = scene_task.scene, scene_task.first
            if scene in lost_before:
                failure = Failure(scene, stage, "WorkerDied" if died else "WorkerRaised", text)
                collect(SceneResult(scene, {}, failure, [StageEvent(scene, stage, "failed", text)]))
            else:
                lost_before.add(scene)
                retried_singly.append(scene_task)

    with run_context(RunContext(store, notify=notify)), progress:
        try:
            while waiting or retried_singly or running:
                while (waiting and len(running) < config.workers) or (
                    retried_singly and not running
                ):
                    size = max(1, min(MAX_BATCH, len(waiting) // (2 * config.workers)))
                    scenes = [(waiting or retried_singly).popleft() for _ in range(size)]
                    batch = store.root, scenes, config.workers, refresh
                    label = scenes[0].scene + (f" and {size - 1} more" if scenes[1:] else "")
                    parameters = {"label": label, "pickled": pickle.dumps(batch)}
                    future = workers.submit(run_batch, parameters)
                    running[future] = scenes, workers.runner
                    future.add_done_callback(news.put)
                event = news.get()
                if isinstance(event, StageEvent):
                    progress.update(event)
                    continue
                scenes, runner = running.pop(event)
                try:
                    results = event.result(raise_on_failure=False)
                    if isinstance(results, BaseException):
                        raise results
                except DamagedError as error:
                    damaged = error
                except StoreError:
                    raise
                except Exception as error:  # each task runner has its own
                    retry(scenes, runner, error)
                else:
                    for result in results:
                        collect(result)
                check_failures(outcome, config.max_failures, len(scene_tasks))
        finally:
            stopped.set()
        if damaged is not None:
            raise damaged
    outcome.failures.sort(key=lambda failure: failure.scene)
    return outcome


def check_failures(outcome: Outcome, max_failures: float, total: int) -> None:
    """Raise TooManyFailuresError if more scenes were left out than a number, or a share below 1.

    A share is one of the scenes that have ended, and allows :data:`MIN_FAILURES` in any case.
    """
    failures = outcome.failures
    ended = len(failures) + len(outcome.refs)
    allowed = max_failures if max_failures >= 1 else max(MIN_FAILURES, max_failures * ended)
    if len(failures) > allowed and ended < total:
        counts = Counter((failure.stage, failure.reason) for failure in failures)
        (stage, reason), count = counts.most_common(1)[0]
        raise TooManyFailuresError(
            f"stopped: {len(failures)} of {ended} are left out, more than max_failures "
            f"{max_failures:g} allows, {count} of them at {stage}: {reason}; remove the cause, or "
            "raise max_failures, and run again: what is finished is in the store",
            failures,
        )


def write_failures(out: Path, failures: Sequence[Failure]) -> None:
    """Write failures to :data:`FAILURES` in a folder; OSError if that fails."""
    spec = load_spec("failures")
    rows = [vars(f) for f in sorted(failures, key=lambda f: (f.scene, f.stage, f.reason))]
    table = pa.Table.from_pylist(rows, schema=spec.schema)
    write_atomic(out / FAILURES, encode_table(table, spec))
