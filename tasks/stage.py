"""Run any stage as a Prefect task, if no run on any machine with this store has done it before.

Results are not left to Prefect: its records name the code that reads them back, pickle among it, so
who may write to the store could have any code run; and it reads all of a result three times to use
it once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any

from prefect import Task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State
from prefect.states import Completed

from slgaussian import threads
from slgaussian.records import Records
from slgaussian.store import ArtifactRef, ArtifactStore, DamagedError
from tasks.keys import cache_key

CHANGED = "was changed after the run had begun; start the run again"
"""What is said of a file whose content is no longer that of the settings."""

_active_store: ContextVar[ArtifactStore] = ContextVar("active_store")
_listener: ContextVar[Callable[[str], None] | None] = ContextVar("listener", default=None)


@dataclass(frozen=True)
class StageCall:
    """One piece of work: a stage, its settings and the refs it reads.

    ``module`` is the import path of the stage module. ``where`` holds the places of files from
    outside, whose contents are hashed into the settings. It, ``scene`` and ``workers`` say where
    and how, never what, so they are not part of the key.
    """

    module: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, ArtifactRef] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)
    scene: str = ""
    workers: int = 1

    @cached_property
    def key(self) -> str:
        """The cache key; raises InputError if there is none."""
        stage = import_module(self.module)
        return cache_key(stage.STAGE, stage.VERSION, self.settings, self.inputs)


@contextmanager
def using(store: ArtifactStore, listener: Callable[[str], None] | None = None) -> Iterator[None]:
    """Make ``store`` the one that tasks submitted within read and write.

    ``listener`` gets what they :func:`tell`.
    """
    tokens = _active_store.set(store), _listener.set(listener)
    try:
        yield
    finally:
        _active_store.reset(tokens[0])
        _listener.reset(tokens[1])


def tell(text: str) -> None:
    """Say how far a long stage is, to whoever watches the run."""
    listener = _listener.get()
    if listener is not None:
        listener(text)


def run_stage(call: StageCall) -> ArtifactRef | State:
    """What ``call`` makes in the active store, found there (a state ``Cached`` with it) or made.

    ``meta["seconds"]`` says how long it took, and ``meta["settings"]`` what made the artifact, with
    models and other files by their digests. A damaged artifact that it should have read is removed
    from the store, so that it is made again.
    """
    store = _active_store.get()
    records = Records(store)
    found = records.find(call.key)
    if found is not None:
        return Completed(name="Cached", data=found)
    threads.share(call.workers)
    stage = import_module(call.module)
    start = time.perf_counter()
    try:
        ref = stage.run(store, call)
    except DamagedError as error:
        store.remove([error.uri])
        raise
    seconds = time.perf_counter() - start
    ref = replace(ref, meta={**ref.meta, "settings": dict(call.settings), "seconds": seconds})
    records.keep(call.key, ref)
    return ref


def stage_task() -> Task:
    """The Prefect task that runs stages."""
    return Task(
        run_stage,
        name="stage",
        task_run_name="{call.scene}",
        cache_policy=NO_CACHE,
        persist_result=False,
    )
