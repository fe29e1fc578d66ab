"""Scenes in batches: the Prefect task that a worker runs, and the loop of a flow that submits it.

A worker may be a thread, a process or another machine, so what goes to it and comes back is small,
plain and picklable; what is large goes through the store. A scene, or a chunk of a corpus, is the
unit of failure: an error takes only its own scene out. A worker that dies costs its batch a retry,
a scene at a time, and a scene whose worker then dies again is left out.
"""

from __future__ import annotations

import pickle
import queue
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.futures import PrefectFuture
from prefect.task_runners import TaskRunner

from flows.runners.progress import Progress
from flows.runners.task_runners import Workers, last_line
from slgaussian.errors import SLGaussianError, one_line
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore, DamagedError
from tasks.context import Notify, RunContext, StageEvent, enclosing_run, run_context

MAX_BATCH = 16
"""Scenes of a batch at most: where all are cached a batch is a second of work."""

DEAD = {
    "BrokenProcessPool",
    "KilledWorker",
    "NodeDiedError",
    "OutOfMemoryError",
    "WorkerCrashedError",
}
"""Errors by which task runners report a dead worker; any other was raised by it."""


@dataclass(frozen=True)
class SceneTask:
    """A scene, or a chunk, to be taken through a pipeline.

    Attributes
    ----------
    scene : str
    pipeline : callable
        A function of a module that calls stages one after the other, with ``arguments``.
    arguments : tuple
    first : str
        The stage that an error before the first stage belongs to.
    """

    scene: str
    pipeline: Callable[..., object]
    arguments: tuple[Any, ...] = ()
    first: str = "ingest"


@dataclass(frozen=True)
class Failure:
    """A scene that was left out: at which stage, what kind of error, and one sentence why."""

    scene: str
    stage: str
    kind: str
    reason: str


@dataclass
class SceneResult:
    """What a worker made of a scene: refs by stage, and the failure that stopped it.

    ``events`` are those of a worker in another process, which nobody heard.
    """

    scene: str
    refs: dict[str, ArtifactRef]
    failure: Failure | None = None
    events: list[StageEvent] = field(default_factory=list)


@dataclass
class Outcome:
    """Refs by scene and stage of the scenes that went through, and failures of the others.

    ``partial`` has the refs of the others, of the stages before the one that failed.
    """

    refs: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    partial: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)


class StoppedError(SLGaussianError):
    """The run ends: raised in a thread that still works on a scene."""


@task(name="scenes", task_run_name="{label}", cache_policy=NO_CACHE, persist_result=False)
def run_batch(label: str, pickled: bytes) -> list[SceneResult]:
    """Take a batch of scenes through their pipelines, one after the other.

    ``pickled`` are the store's root, the scene tasks, the number of workers and the stages to
    compute anew: for threads too, so that what one task runner can send, all can. Events go to the
    flow if it is in this process.
    """
    root, scene_tasks, workers, refresh = pickle.loads(pickled)
    store, enclosing = ArtifactStore(root), enclosing_run()
    results = []
    for scene_task in scene_tasks:
        events: list[StageEvent] = []
        notify = events.append if enclosing is None else enclosing.notify
        result = compute_scene(scene_task, store, workers, notify, refresh)
        results.append(SceneResult(scene_task.scene, *result, events))
    return results


def compute_scene(
    scene_task: SceneTask,
    store: ArtifactStore,
    workers: int,
    notify: Notify,
    refresh: frozenset[str] = frozenset(),
) -> tuple[dict[str, ArtifactRef], Failure | None]:
    """Return the refs of all stages, or of those before the one that failed, and its failure.

    A damaged artifact that a stage reads is computed again, once: the pipeline is called anew, and
    what is not damaged comes from the store. DamagedError if another scene made it.
    """
    run = RunContext(store, scene_task.scene, workers, notify, refresh, stage=scene_task.first)
    repaired: set[str] = set()
    while True:
        try:
            with run_context(run):
                scene_task.pipeline(*scene_task.arguments)
            return run.refs, None
        except StoppedError:
            raise
        except DamagedError as error:
            uris = (
                uri for ref in run.refs.values() for uri in (ref.uri, *ref.meta.get("parts", ()))
            )
            if error.uri not in uris:
                raise
            if error.uri not in repaired:
                repaired.add(error.uri)
                continue
            problem: Exception | SystemExit = error
        except (Exception, SystemExit) as error:  # whatever it is, the other scenes go on
            problem = error
        expected = isinstance(problem, SLGaussianError)
        reason = " ".join(str(problem).split()) or type(problem).__name__
        if not expected:
            reason = f"unexpected {type(problem).__name__}: {reason}"
        trace = "" if expected else "".join(traceback.format_exception(problem)).rstrip()
        notify(StageEvent(run.scene, run.stage, "failed", reason, traceback=trace))
        return run.refs, Failure(run.scene, run.stage, type(problem).__name__, reason)


def map_scenes(scene_tasks: Iterable[SceneTask], workers: Workers, progress: Progress) -> Outcome:
    """Have the workers of a flow compute all scene tasks; called within a Prefect flow.

    As many batches as there are workers are under way at a time, each with one scene in memory.

    Raises
    ------
    DamagedError
        In the end, if a scene needs an artifact of another one that is damaged, and is removed.
    SLGaussianError
        If the task runner takes on no more work.
    """
    outcome = Outcome()
    damaged: DamagedError | None = None
    waiting = deque(_sendable(scene_tasks, outcome, progress))
    alone: deque[SceneTask] = deque()
    lost_before: set[str] = set()
    news: queue.SimpleQueue[StageEvent | PrefectFuture[Any]] = queue.SimpleQueue()
    running: dict[PrefectFuture[Any], tuple[list[SceneTask], TaskRunner[Any]]] = {}
    stopped = threading.Event()

    def notify(event: StageEvent) -> None:
        if stopped.is_set():
            raise StoppedError("stopped")
        news.put(event)

    def submit(scenes: list[SceneTask]) -> None:
        batch = workers.store.root, scenes, workers.count, workers.refresh
        label = scenes[0].scene + (f" and {len(scenes) - 1} more" if scenes[1:] else "")
        future = workers.submit(run_batch, {"label": label, "pickled": pickle.dumps(batch)})
        running[future] = scenes, workers.runner
        future.add_done_callback(news.put)

    def lose(scenes: list[SceneTask], runner: TaskRunner[Any], error: BaseException) -> None:
        died, reason = type(error).__name__ in DEAD, last_line(str(error)) or type(error).__name__
        what = f"died ({reason})" if died else f"raised {type(error).__name__}: {reason}"
        progress.lost(died, what, [scene_task.scene for scene_task in scenes])
        for scene_task in scenes:
            if scene_task.scene in lost_before:
                _leave_out(scene_task, died, what, outcome, progress)
            else:
                alone.append(scene_task)
        lost_before.update(scene_task.scene for scene_task in scenes)
        if died:
            workers.restart(runner)

    with run_context(RunContext(workers.store, notify=notify)):
        try:
            while waiting or alone or running:
                while waiting and len(running) < workers.count:
                    size = max(1, min(MAX_BATCH, len(waiting) // (2 * workers.count)))
                    submit([waiting.popleft() for _ in range(size)])
                if alone and not running:
                    submit([alone.popleft()])
                event = news.get()
                if isinstance(event, StageEvent):
                    progress.update(event)
                    continue
                scenes, runner = running.pop(event)
                try:
                    results = event.result()
                except DamagedError as error:
                    damaged = error
                except Exception as error:  # each task runner has its own
                    lose(scenes, runner, error)
                else:
                    _collect(results, outcome, progress)
        finally:
            stopped.set()
    if damaged is not None:
        raise damaged
    outcome.failures.sort(key=lambda failure: failure.scene)
    return outcome


def map_shown(
    scene_tasks: Sequence[SceneTask], workers: Workers, stages: int, unit: str, verbose: bool
) -> Outcome:
    """Do :func:`map_scenes` with a progress of its own; nothing if there are no tasks."""
    if not scene_tasks:
        return Outcome()
    with Progress(len(scene_tasks), stages, verbose, unit=unit) as progress:
        outcome = map_scenes(scene_tasks, workers, progress)
    progress.summary()
    return outcome


def _sendable(
    scene_tasks: Iterable[SceneTask], outcome: Outcome, progress: Progress
) -> list[SceneTask]:
    """Return the scene tasks that can be pickled; the others are left out."""
    sendable = []
    for scene_task in scene_tasks:
        try:
            pickle.dumps(scene_task)
        except Exception as error:  # whatever it holds has its own
            kind = type(error).__name__
            reason = one_line(f"cannot be sent to a worker: unexpected {kind}: {error}")
            failure = Failure(scene_task.scene, scene_task.first, kind, reason)
            outcome.failures.append(failure)
            progress.update(StageEvent(scene_task.scene, scene_task.first, "failed", reason))
        else:
            sendable.append(scene_task)
    return sendable


def _leave_out(
    scene_task: SceneTask, died: bool, what: str, outcome: Outcome, progress: Progress
) -> None:
    reason = f"its worker {what} twice, the second time with no other scene beside it"
    if died:
        reason += "; it may need more memory than there is: try it with --workers 1"
    kind = "WorkerDied" if died else "WorkerRaised"
    outcome.failures.append(Failure(scene_task.scene, scene_task.first, kind, reason))
    progress.update(StageEvent(scene_task.scene, scene_task.first, "failed", reason))


def _collect(results: Sequence[SceneResult], outcome: Outcome, progress: Progress) -> None:
    for result in results:
        for event in result.events:
            progress.update(event)
        if result.failure is None:
            outcome.refs[result.scene] = result.refs
        else:
            outcome.failures.append(result.failure)
            outcome.partial[result.scene] = result.refs


def failures_table(failures: Sequence[Failure]) -> pa.Table:
    """Return the failures as a table of spec ``failures``."""
    rows = [vars(failure) for failure in failures]
    return pa.Table.from_pylist(rows, schema=load_spec("failures").schema)


def write_failures(out: Path, failures: Sequence[Failure]) -> None:
    """Write them to ``failures.parquet`` in a folder; OSError if that fails."""
    data = encode_table(failures_table(failures), load_spec("failures"))
    write_atomic(out / "failures.parquet", data)
