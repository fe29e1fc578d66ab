"""Take many scenes down their roads, as one Prefect flow that a bad scene cannot stop."""

from __future__ import annotations

import logging
import os
import pickle
import queue
import threading
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import pyarrow as pa
from httpx import HTTPError
from prefect import Flow
from prefect.context import FlowRunContext
from prefect.futures import PrefectFuture
from prefect.settings import PREFECT_FLOWS_HEARTBEAT_FREQUENCY, temporary_settings
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner

from flows.runners.journal import log
from flows.runners.progress import Progress
from flows.runners.shard import (
    NO_EVENTS,
    Failure,
    Job,
    Order,
    Shard,
    StoppedError,
    roll_call,
    shard_task,
    watching,
)
from flows.runners.task_runners import abandon, last_line, started, without_interrupts
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.storage.remote import redacted
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore, DamagedError, encode_table
from tasks.events import Event, Failed

Made = TypeVar("Made")

MOST = 500
"""Most jobs of a shard; where all are done already they take a second or so."""

LONG = 20.0
"""Seconds after which a worker begins no other job of its shard: what a worker that dies has not
told of is little, and the end of the run is shared out well."""

PATIENCE = 120.0
"""Seconds that the workers of a cluster may take to begin."""

DEATHS = 4
"""So often a job may be in a shard whose worker dies before it is left out."""


@dataclass
class Outcome:
    """What a run made: refs by scene and stage of the scenes that went through, and the others.

    ``begun`` has the refs of the others, of the stages before the one that failed.
    """

    refs: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    begun: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)


DEAD = {
    "BrokenProcessPool",
    "KilledWorker",
    "NodeDiedError",
    "OutOfMemoryError",
    "WorkerCrashedError",
}
"""Errors by which the runners say that a worker died; any other was raised by it."""


@dataclass(frozen=True)
class Lost:
    """How a shard was lost: whether its worker died, or which error it raised."""

    died: bool
    reason: str

    @property
    def sentence(self) -> str:
        """Of the worker, without its subject."""
        return f"died ({self.reason})" if self.died else f"raised {self.reason}"


class WorkerPool:
    """The workers of a flow, and what they tell, in one queue.

    A pool of processes is of no use once one of them has died: then another is started.
    """

    def __init__(self, store: ArtifactStore, workers: int) -> None:
        self.store, self.workers = store, workers
        context = FlowRunContext.get()
        assert context is not None  # a pool is made inside a flow
        self.runner = context.task_runner
        self.news: queue.SimpleQueue[Event | PrefectFuture] = queue.SimpleQueue()
        self.running: dict[PrefectFuture, tuple[TaskRunner, list[Job]]] = {}
        self.stop = threading.Event()
        self.stack = ExitStack()

    def __enter__(self) -> WorkerPool:
        self.token = watching.set(self._heard)
        return self

    def __exit__(self, *error: object) -> None:
        watching.reset(self.token)
        if self.running:
            self.stop.set()
            abandon(self.runner)
        self.stack.close()

    def call(self, runner: str) -> None:
        """Wait for a worker that can do the work; InputError if one cannot, or there is none."""
        probe = f".probe-{uuid.uuid4().hex}"
        self.store.write(probe, b"")
        asked = {"root": self.store.root, "probe": probe, "server": os.environ["PREFECT_API_URL"]}
        try:
            self.runner.submit(roll_call, asked).result(timeout=PATIENCE)
        except TimeoutError as error:
            raise InputError(
                f"runner: no worker of {runner} took on any work within {PATIENCE:.0f} s; start "
                "one, or wait until one is free"
            ) from error
        except Exception as error:  # each runner has its own
            raise InputError(
                f"runner: a worker of {runner} cannot do the work ({last_line(str(error))}); it "
                "needs the packages that are installed here, and the same store and server within "
                "its reach"
            ) from error
        finally:
            self.store.remove([probe])

    @property
    def busy(self) -> int:
        """How many shards are under way."""
        return len(self.running)

    def submit(self, shard: list[Job]) -> None:
        """Have a worker take this shard on."""
        order = Order(self.store.root, shard, self.workers, LONG)
        try:
            with without_interrupts():
                future = self.runner.submit(shard_task(order), {"pickled": pickle.dumps(order)})
        except Exception as error:  # each runner has its own
            said = one_line(f"{type(error).__name__}: {error}")
            raise SLGaussianError(
                f"runner: takes on no more work ({said}); what was made is in the store: if the "
                "cluster has gone, start it, and the same command goes on"
            ) from error
        self.running[future] = self.runner, shard
        future.add_done_callback(self.news.put)

    def next(self) -> list[Event | tuple[list[Job], Shard | Lost | DamagedError]]:
        """What happened next: events, and a shard with what was made of it or how it was lost."""
        news = self.news.get()
        if isinstance(news, Event):
            return [news]
        runner, shard = self.running.pop(news)
        made = _result(news)
        if isinstance(made, Shard):
            return [*made.events, (shard, made)]
        died = isinstance(made, Lost) and made.died
        if died and runner is self.runner and isinstance(runner, ProcessPoolTaskRunner):
            self.runner = self.stack.enter_context(runner.duplicate())
        return [(shard, made)]

    def _heard(self, event: Event) -> None:
        if self.stop.is_set():
            raise StoppedError("stopped")
        self.news.put(event)


class _Here:
    """What stays in this process: the work of a flow, what it is called with, and what it made.

    Prefect sends the flow along with every shard, though workers never call it, and with it what it
    was called with: here every scene of the run, and who is told of it.
    """

    def __init__(self, work: Callable[[], Any] | None = None) -> None:
        self.work = work
        self.made: list[Any] = []

    def __reduce__(self) -> tuple[type[_Here], tuple[()]]:
        return _Here, ()


def _run(here: _Here) -> None:
    assert here.work is not None  # only what was sent elsewhere has none
    here.made.append(here.work())


class JobFlow(Generic[Made]):
    """A Prefect flow over a :class:`WorkerPool`; made by :func:`job_flow`."""

    def __init__(self, work: Callable[..., Made], name: str) -> None:
        self.work, self.__doc__ = work, work.__doc__
        self.flow = Flow(_run, name=name, persist_result=False, validate_parameters=False)

    def __call__(self, store: ArtifactStore, runner: str, workers: int, *given: Any) -> Made:
        """Run it with a pool of ``workers`` and the further arguments ``given``.

        Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

        Parameters
        ----------
        store : ArtifactStore
            The one that the workers use.
        runner : str
            Who they are, as :data:`flows.settings.Runner` has it.
        workers : int
            How many they are.

        Raises
        ------
        InputError
            As :func:`flows.runners.task_runners.started`.
        SLGaussianError
            If the Prefect server fails during the run.
        """

        def work() -> Made:
            with WorkerPool(store, workers) as pool:
                if "://" in runner:
                    pool.call(runner)
                return self.work(pool, *given)

        here = _Here(work)
        with started(runner, workers, store) as task_runner, _heard_by_nobody():
            try:
                self.flow.with_options(task_runner=task_runner)(here)
            except HTTPError as error:  # as when it was killed, or its disk is full
                url, home = redacted(os.environ["PREFECT_API_URL"]), os.environ["PREFECT_HOME"]
                failed = f"the Prefect server at {url} failed ({error})"
                if not here.made:
                    raise SLGaussianError(
                        f"{failed}; start it, or unset PREFECT_API_URL, as none of yours is "
                        f"needed; one of our own may need room on the disk of {home}; what was "
                        "made is in the store, and the same command goes on"
                    ) from error
                said = f"{failed} when all was done; it may show this run as running for ever"
                log(logging.WARNING, "server_failed", said)
        return here.made[0]


def job_flow(name: str) -> Callable[[Callable[..., Made]], JobFlow[Made]]:
    """Make a function a Prefect flow of this name; its first argument is the pool that works."""
    return lambda work: JobFlow(work, name)


@contextmanager
def _heard_by_nobody() -> Iterator[None]:
    """Without heartbeats, if events are not sent: they would delay the end by up to a second."""
    silent = {PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None} if NO_EVENTS in os.environ else {}
    with temporary_settings(silent):
        yield


def work_through_all(jobs: Iterable[Job], pool: WorkerPool, progress: Progress) -> Outcome:
    """Have a pool do all the jobs.

    As many shards as it has workers are under way at a time, each with one scene in memory. An
    error takes only its own scene out. When a worker dies or raises an error, the jobs of its
    shard are tried again, each by itself; those that were lost twice with no other beside them, so
    that it is known which one is to blame.

    Raises
    ------
    DamagedError
        In the end, if a job needs an artifact of another job that is damaged, and is removed.
    """
    outcome = Outcome()
    waiting: deque[Job] = deque()
    alone: deque[Job] = deque()
    deaths: Counter[str] = Counter()
    damaged: DamagedError | None = None

    def next_shard() -> list[Job]:
        size = min(MOST, len(waiting) // (2 * pool.workers))
        shard = [waiting.popleft()]
        # What was lost before is tried by itself.
        while len(shard) < size and not deaths[shard[0].scene] + deaths[waiting[0].scene]:
            shard.append(waiting.popleft())
        return shard

    def leave_out(job: Job, kind: str, reason: str) -> None:
        outcome.failures.append(Failure(job.scene, job.first, kind, reason))
        progress.hear(Failed(job.scene, job.first, reason))

    def lose(job: Job, loss: Lost) -> None:
        deaths[job.scene] += 1
        if deaths[job.scene] < DEATHS:
            (waiting if deaths[job.scene] == 1 else alone).append(job)
        elif loss.died:
            leave_out(
                job,
                "WorkerDied",
                f"its worker died {DEATHS} times, the last with nothing beside it ({loss.reason}); "
                "it may need more memory than there is: try it with --workers 1",
            )
        else:
            leave_out(job, "WorkerRaised", f"its worker raised {loss.reason}, {DEATHS} times")

    for job in jobs:
        try:
            pickle.dumps(job)
        except Exception as error:  # whatever it holds says why in its own way
            reason = f"cannot be sent to a worker: unexpected {type(error).__name__}: {error}"
            leave_out(job, type(error).__name__, one_line(reason))
        else:
            waiting.append(job)
    while waiting or alone or pool.busy:
        while waiting and pool.busy < pool.workers:
            pool.submit(next_shard())
        if alone and not pool.busy:
            pool.submit([alone.popleft()])
        for happened in pool.next():
            if isinstance(happened, Event):
                progress.hear(happened)
                continue
            shard, made = happened
            if isinstance(made, Shard):
                outcome.refs |= made.refs
                outcome.failures += made.failures
                outcome.begun |= made.begun
                waiting.extendleft(reversed(shard[len(shard) - made.undone :]))
            elif isinstance(made, DamagedError):
                damaged = made
            else:
                progress.lost(made.died, made.sentence, [job.scene for job in shard])
                for job in shard:
                    progress.dropped(job.scene)
                    lose(job, made)
    if damaged is not None:
        raise damaged
    outcome.failures.sort(key=lambda failure: failure.scene)
    return outcome


def _result(future: PrefectFuture) -> Shard | Lost | DamagedError:
    """What a worker made, the artifact that it needs made again, or what is known of its end."""
    try:
        made = future.result(raise_on_failure=False)
        if isinstance(made, (Shard, DamagedError)):
            return made
        text = one_line(str(made))
    except Exception as error:  # each runner has its own, with the traceback of the worker
        made, text = error, last_line(str(error))
    name = type(made).__name__
    return Lost(True, text or name) if name in DEAD else Lost(False, f"{name}: {text}")


def failures_table(failures: Sequence[Failure]) -> pa.Table:
    """The failures as a table of spec ``failures``."""
    rows = [vars(failure) for failure in failures]
    return pa.Table.from_pylist(rows, schema=load_spec("failures").schema)


def failures_file(failures: Sequence[Failure]) -> bytes:
    """The same as a Parquet file."""
    return encode_table(failures_table(failures), load_spec("failures"))
