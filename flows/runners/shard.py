"""Take some scenes down their roads: the unit of work that a worker is given.

A worker may be a thread, a process or another machine, so all that goes to it and comes back is
small, plain and picklable; what is large goes through the store.
"""

from __future__ import annotations

import os
import pickle
import time
import traceback
import urllib.request
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from prefect import Task
from prefect.cache_policies import NO_CACHE
from prefect.events.clients import NullEventsClient
from prefect.events.worker import EventsWorker

from slgaussian.errors import InputError, SLGaussianError
from slgaussian.storage.remote import redacted
from slgaussian.storage.store import ArtifactRef, ArtifactStore, DamagedError
from tasks.events import Event, Failed, Listener
from tasks.stage import Worksite, at

ANSWER = 10.0
"""Seconds that the Prefect server may take to answer a worker."""

NO_EVENTS = "SLGAUSSIAN_NO_EVENTS"
"""Environment variable that is set if nobody reads the events that Prefect has of every task: they
cost a worker and the server some 25 ms a task, and the database 25 kB."""


def send_no_events() -> None:
    """Have this process keep Prefect's events to itself."""
    EventsWorker.set_client_override(NullEventsClient)


if NO_EVENTS in os.environ:
    send_no_events()  # a worker loads this module with its first task, before any event of it


@dataclass(frozen=True)
class Job:
    """A scene, or a chunk, to be taken down a road.

    Attributes
    ----------
    scene : str
    road : callable
        A function of a module, which calls stages one after the other; it is called by a worker
        when the turn of the job comes, with ``arguments``.
    arguments : tuple
    first : str
        The stage that an error before the first stage belongs to.
    """

    scene: str
    road: Callable[..., object]
    arguments: tuple[Any, ...] = ()
    first: str = "ingest"


@dataclass(frozen=True)
class Failure:
    """A scene that was left out: where, what kind of error, and one sentence why."""

    scene: str
    stage: str
    kind: str
    reason: str


@dataclass
class Shard:
    """What a worker made of the jobs that it was given.

    Attributes
    ----------
    refs : dict
        By scene and stage, those of the scenes that went through.
    failures : list of Failure
        The scenes that did not.
    begun : dict
        As ``refs``, what was made of those before they failed.
    undone : int
        How many of the last jobs it did not come to.
    events : list of Event
        What happened, if nobody listened.
    """

    refs: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    begun: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    undone: int = 0
    events: list[Event] = field(default_factory=list)


watching: ContextVar[Listener | None] = ContextVar("watching", default=None)
"""Who hears of events while they happen: threads of the same process can be watched."""


class StoppedError(SLGaussianError):
    """The run is to end: raised by a listener, it ends the shard."""


@dataclass(frozen=True)
class Order:
    """What a worker is asked to do.

    Attributes
    ----------
    root : str
        The store, as :class:`~slgaussian.storage.store.ArtifactStore` takes it.
    jobs : sequence of Job
    workers : int
        How many shards are worked on at the same time on this machine.
    seconds : float
        After so long no other job is begun.
    """

    root: str
    jobs: Sequence[Job]
    workers: int
    seconds: float


def work_through(pickled: bytes) -> Shard:
    """Take the jobs of an order down their roads, one after the other, until its time is over.

    So a shard may have thousands of scenes that are done already and still be a matter of seconds
    where they are not. One job at least is done. An error takes only its own scene out.

    Parameters
    ----------
    pickled : bytes
        An :class:`Order`, pickled for threads too: what one runner can send, all can.
    """
    order: Order = pickle.loads(pickled)
    shard, store = Shard(), ArtifactStore(order.root)
    listener = watching.get() or shard.events.append
    end = time.perf_counter() + order.seconds
    for done, job in enumerate(order.jobs):
        if done and time.perf_counter() > end:
            shard.undone = len(order.jobs) - done
            break
        made, failure = work_on(job, store, order.workers, listener)
        if failure is None:
            shard.refs[job.scene] = made
        else:
            shard.failures.append(failure)
            shard.begun[job.scene] = made
    return shard


def shard_task(order: Order) -> Task:
    """The Prefect task :func:`work_through`, named after the jobs of an order."""
    more = f" and {len(order.jobs) - 1} more" if order.jobs[1:] else ""
    return Task(
        # By its own name, so that workers import it: a decorated one would be sent as code.
        work_through,
        name="scenes",
        task_run_name=f"{order.jobs[0].scene}{more}",
        cache_policy=NO_CACHE,
        persist_result=False,
    )


def work_on(
    job: Job, store: ArtifactStore, workers: int, listener: Listener
) -> tuple[dict[str, ArtifactRef], Failure | None]:
    """The refs of all stages of a job, or of those before the one that failed, and what stopped it.

    A damaged artifact that a stage finds is made again, once: the road is taken anew, and what is
    not damaged is found in the store. DamagedError if another job made it.
    """
    site = Worksite(store, job.scene, workers, listener, stage=job.first)
    remade: set[str] = set()
    while True:
        try:
            with at(site):
                job.road(*job.arguments)
            return site.made, None
        except StoppedError:
            raise
        except DamagedError as error:
            if not _made_here(error.uri, site.made):
                raise
            if error.uri not in remade:
                remade.add(error.uri)
                continue
            problem: Exception | SystemExit = error
        except (Exception, SystemExit) as error:  # whatever it is, the other scenes go on
            problem = error
        failure = _failure(job.scene, site.stage, problem)
        known = isinstance(problem, SLGaussianError)
        trace = "" if known else "".join(traceback.format_exception(problem)).rstrip()
        listener(Failed(job.scene, site.stage, failure.reason, trace))
        return site.made, failure


def answer_roll_call(root: str, probe: str, server: str) -> None:
    """Fail with InputError where a worker could not do its work.

    Parameters
    ----------
    root : str
        The store.
    probe : str
        A file that is in it.
    server : str
        URL of the Prefect server's API.
    """
    store = ArtifactStore(root)
    try:
        store.check_there(probe)
    except DamagedError as error:
        raise InputError(f"it has another store at {store.root}") from error
    store.check_writable()
    try:
        urllib.request.urlopen(f"{server}/health", timeout=ANSWER).close()
    except OSError as error:
        raise InputError(f"it does not reach the server at {redacted(server)}: {error}") from error


roll_call = Task(answer_roll_call, name="roll-call", cache_policy=NO_CACHE, persist_result=False)


def _failure(scene: str, stage: str, error: Exception | SystemExit) -> Failure:
    reason = " ".join(str(error).split()) or type(error).__name__
    if not isinstance(error, SLGaussianError):
        reason = f"unexpected {type(error).__name__}: {reason}"
    return Failure(scene, stage, type(error).__name__, reason)


def _made_here(uri: str, refs: dict[str, ArtifactRef]) -> bool:
    return any(uri in (ref.uri, *ref.meta.get("parts", ())) for ref in refs.values())
