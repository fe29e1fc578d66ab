"""Take some scenes, each a chain of stages, through their stages: the unit that a worker is given.

A worker may be a thread, a process or another machine, so all that goes to it and comes back is
small, plain and picklable; what is large goes through the store.
"""

from __future__ import annotations

import os
import time
import traceback
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from prefect import Task
from prefect.cache_policies import NO_CACHE
from prefect.events.clients import NullEventsClient
from prefect.events.worker import EventsWorker

from slgaussian.errors import InputError, SLGaussianError
from slgaussian.storage.remote import masked
from slgaussian.storage.store import ArtifactRef, ArtifactStore, DamagedError
from tasks.stage import StageCall, listening, run_stage

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

    def call(self, refs: Mapping[str, ArtifactRef], scene: str = "", workers: int = 1) -> StageCall:
        """The work itself, once the refs that it reads are there."""
        module = f"{self.package}.{self.stage}"
        inputs = {name: refs[source] for name, source in self.inputs.items()}
        return StageCall(module, self.settings, inputs, self.where, scene, workers)


@dataclass(frozen=True)
class Chain:
    """The stages of one scene, and the refs that it begins with, by stage.

    ``plan`` lists the steps, given the store; it is asked by the worker when the chain's turn
    comes, as it reads files to hash them. ``first`` names the stage that an error in the plan
    belongs to.
    """

    scene: str
    plan: Callable[[ArtifactStore], Sequence[Step]]
    refs: Mapping[str, ArtifactRef] = field(default_factory=dict)
    first: str = "ingest"


def given(steps: Sequence[Step], store: ArtifactStore) -> Sequence[Step]:
    """The plan of steps that are known beforehand."""
    return steps


@dataclass(frozen=True)
class Failure:
    """A scene that was left out: where, what kind of error, and one sentence why."""

    scene: str
    stage: str
    kind: str
    reason: str


@dataclass(frozen=True)
class Event:
    """What happened to a scene at a stage.

    ``kind`` is a method of :class:`flows.runners.progress.Progress` that says it: started, said,
    finished, went_back, or failed; ``facts`` are its further arguments.
    """

    kind: str
    scene: str
    stage: str
    facts: tuple[Any, ...] = ()


@dataclass
class Shard:
    """What a worker made of the chains that it was given.

    Attributes
    ----------
    refs : dict
        By scene and stage, those of the scenes that went through.
    failures : list of Failure
        The scenes that did not.
    begun : dict
        As ``refs``, what was made of those before they failed.
    undone : int
        How many of the last chains it did not come to.
    events : list of Event
        What happened, if nobody listened.
    """

    refs: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    begun: dict[str, dict[str, ArtifactRef]] = field(default_factory=dict)
    undone: int = 0
    events: list[Event] = field(default_factory=list)


Listener = Callable[[Event], None]
watching: ContextVar[Listener | None] = ContextVar("watching", default=None)
"""Who hears of events while they happen: threads of the same process can be watched."""


def run_shard(root: str, chains: Sequence[Chain], workers: int, seconds: float) -> Shard:
    """Take chains through their stages, one after the other, until ``seconds`` are over.

    So a shard may have thousands of scenes that are done already and still be a matter of seconds
    where they are not. One chain at least is gone through. An error takes only its own chain out.

    Parameters
    ----------
    root : str
        The store, as :class:`~slgaussian.storage.store.ArtifactStore` takes it.
    chains : sequence of Chain
    workers : int
        How many shards are worked on at the same time on this machine.
    seconds : float
    """
    shard, store = Shard(), ArtifactStore(root)
    listener = watching.get() or shard.events.append
    end = time.perf_counter() + seconds
    for done, chain in enumerate(chains):
        if done and time.perf_counter() > end:
            shard.undone = len(chains) - done
            break
        made, failure = run_chain(store, chain, workers, listener)
        if failure is None:
            shard.refs[chain.scene] = made
        else:
            shard.failures.append(failure)
            shard.begun[chain.scene] = made
    return shard


def run_chain(
    store: ArtifactStore, chain: Chain, workers: int, listener: Listener
) -> tuple[dict[str, ArtifactRef], Failure | None]:
    """The refs of all its stages, or of those before the one that failed, and what stopped it.

    A damaged artifact that a stage finds is made again, once, by the stage that made it.
    """
    refs, stage, position = dict(chain.refs), chain.first, 0
    remade: set[str] = set()

    def happened(kind: str, *facts: Any) -> None:
        listener(Event(kind, chain.scene, stage, facts))

    try:
        steps = chain.plan(store)
        while position < len(steps):
            stage = steps[position].stage
            happened("started")
            start = time.perf_counter()
            try:
                with listening(partial(happened, "said")):
                    call = steps[position].call(refs, chain.scene, workers)
                    refs[stage], cached = run_stage(store, call)
            except DamagedError as error:
                maker = _maker(error.uri, steps[:position], refs)
                if maker is None or error.uri in remade:
                    raise
                remade.add(error.uri)
                happened("went_back", position - maker, str(error))
                position = maker
            else:
                happened("finished", time.perf_counter() - start, cached)
                position += 1
    except StoppedError:
        raise
    except Exception as error:  # whatever it is, the other scenes go on
        failure = _failure(chain.scene, stage, error)
        known = isinstance(error, SLGaussianError)
        trace = "" if known else "".join(traceback.format_exception(error)).rstrip()
        happened("failed", failure.reason, trace)
        return refs, failure
    return refs, None


class StoppedError(SLGaussianError):
    """The run is to end: raised by a listener, it ends the shard."""


def shard_task(root: str, chains: Sequence[Chain], workers: int, seconds: float) -> Task:
    """The Prefect task that runs a shard, with all that it needs.

    It takes no parameters: task runners look for futures all through them, each in its own way.
    """

    def work() -> Shard:
        return run_shard(root, chains, workers, seconds)

    more = f" and {len(chains) - 1} more" if chains[1:] else ""
    return Task(
        work,
        name="scenes",
        task_run_name=f"{chains[0].scene}{more}",
        cache_policy=NO_CACHE,
        persist_result=False,
    )


def roll_call(root: str, probe: str, server: str) -> Task:
    """The Prefect task that fails with InputError where a worker could not do its work.

    Parameters
    ----------
    root : str
        The store.
    probe : str
        A file that is in it.
    server : str
        URL of the Prefect server's API.
    """

    def work() -> None:
        store = ArtifactStore(root)
        try:
            store.check_there(probe)
        except DamagedError as error:
            raise InputError(f"it has another store at {store.root}") from error
        store.check_writable()
        try:
            urllib.request.urlopen(f"{server}/health", timeout=ANSWER).close()
        except OSError as error:
            raise InputError(
                f"it does not reach the server at {masked(server)}: {error}"
            ) from error

    return Task(work, name="roll-call", cache_policy=NO_CACHE, persist_result=False)


def _failure(scene: str, stage: str, error: Exception) -> Failure:
    reason = " ".join(str(error).split()) or type(error).__name__
    if not isinstance(error, SLGaussianError):
        reason = f"unexpected {type(error).__name__}: {reason}"
    return Failure(scene, stage, type(error).__name__, reason)


def _maker(uri: str, steps: Sequence[Step], refs: Mapping[str, ArtifactRef]) -> int | None:
    """Which of the steps made the artifact at ``uri``."""
    for position, step in enumerate(steps):
        ref = refs[step.stage]
        if uri in (ref.uri, *ref.meta.get("parts", ())):
            return position
    return None
