"""Do the work of any stage, if no run on any machine with this store has done it before.

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

from slgaussian.kernels import compiling, threads
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactRef, ArtifactStore, DamagedError
from tasks.keys import cache_key

CHANGED = "was changed after the run had begun; start the run again"
"""What is said of a file whose content is no longer that of the settings."""

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
def listening(listener: Callable[[str], None]) -> Iterator[None]:
    """Have ``listener`` get what stages that run within :func:`tell`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def tell(text: str) -> None:
    """Say how far a long stage is, to whoever watches the run."""
    listener = _listener.get()
    if listener is not None:
        listener(text)


def run_stage(store: ArtifactStore, call: StageCall) -> tuple[ArtifactRef, bool]:
    """What ``call`` makes, and whether it was found in the store and not made now.

    What is made is a task of Prefect's, which so knows of each stage of each scene.
    ``meta["seconds"]`` says how long it took, and ``meta["settings"]`` what made the artifact, with
    models and other files by their digests. A damaged artifact that it should have read is removed
    from the store, so that it is made again.
    """
    records = Records(store)
    found = records.find(call.key)
    if found is not None:
        return found, True
    threads.share(call.workers)
    compiling.watch()
    stage = import_module(call.module)

    def work() -> ArtifactRef:
        start = time.perf_counter()
        with compiling.told_to(tell):
            ref = stage.run(store, call)
        seconds = time.perf_counter() - start
        return replace(ref, meta={**ref.meta, "settings": dict(call.settings), "seconds": seconds})

    task = Task(
        work,
        name=stage.STAGE,
        task_run_name=call.scene or None,
        cache_policy=NO_CACHE,
        persist_result=False,
    )
    try:
        ref = task()
    except DamagedError as error:
        store.remove([error.uri])
        raise
    records.keep(call.key, ref)
    return ref, False
