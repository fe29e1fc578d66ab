"""Run any stage as a Prefect task whose result is cached by content and checked when reused."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from prefect import Task
from prefect.cache_policies import CachePolicy
from prefect.context import TaskRunContext
from prefect.filesystems import RemoteFileSystem
from prefect.serializers import Serializer

from slgaussian import threads
from slgaussian.store import ArtifactRef, ArtifactStore
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
        """The cache key; raises InputError if there is none.

        Prefect drops an error in a key and computes without a cache, so ask for the key before
        submitting.
        """
        stage = import_module(self.module)
        return cache_key(stage.STAGE, stage.VERSION, self.settings, self.inputs)


class StageKey(CachePolicy):
    """Cache by :attr:`StageCall.key`.

    Prefect's own policies collide between tasks, follow file names and not contents, and see
    neither the library nor its version.
    """

    def compute_key(
        self,
        task_ctx: TaskRunContext,
        inputs: dict[str, Any],
        flow_parameters: dict[str, Any],
        **kwargs: Any,
    ) -> str:
        """The key of the call that the task was given."""
        return inputs["call"].key


class RefSerializer(Serializer):
    """Keeps refs as JSON; reading one back fails unless its artifact is there and intact.

    Prefect takes a result that cannot be read for a miss, so a lost or damaged artifact is made
    again, and only that one. The store is the one of :func:`using`, not a path in the record:
    a store that was moved or mounted elsewhere still hits.
    """

    type: Literal["slgaussian-ref"] = "slgaussian-ref"

    def dumps(self, obj: ArtifactRef) -> bytes:
        """The ref as JSON."""
        return json.dumps(asdict(obj), sort_keys=True).encode()

    def loads(self, blob: bytes) -> ArtifactRef:
        """The ref, after a look at its artifact; SpecError if that is missing or damaged.

        An artifact that names others lists them in ``meta["parts"]``: they must be there too.
        """
        ref = ArtifactRef(**json.loads(blob))
        store = _active_store.get()
        store.get(ref)
        for uri in ref.meta.get("parts", ()):
            store.check_there(uri)
        return ref


@contextmanager
def using(store: ArtifactStore, listener: Callable[[str], None] | None = None) -> Iterator[None]:
    """Make ``store`` the one that tasks submitted within read, write and check.

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


def run_stage(call: StageCall) -> ArtifactRef:
    """Do the work of ``call`` in the active store.

    ``meta["seconds"]`` says how long it took, and ``meta["settings"]`` what made the artifact, with
    models and other files by their digests.
    """
    threads.share(call.workers)
    stage = import_module(call.module)
    start = time.perf_counter()
    ref = stage.run(_active_store.get(), call)
    seconds = time.perf_counter() - start
    return replace(ref, meta={**ref.meta, "settings": dict(call.settings), "seconds": seconds})


def stage_task(store: ArtifactStore) -> Task:
    """The Prefect task that runs stages with their records under ``<store>/cache``."""
    return Task(
        run_stage,
        name="stage",
        task_run_name="{call.scene}",
        cache_policy=StageKey(),
        persist_result=True,
        cache_result_in_memory=False,
        result_serializer=RefSerializer(),
        result_storage=_record_storage(store),
    )


def _record_storage(store: ArtifactStore) -> Path | RemoteFileSystem:
    if store.local:
        return Path(store.path) / "cache"
    # Prefect accepts only a saved block here; saving the same one again changes nothing.
    block = RemoteFileSystem(basepath=f"{store.root}/cache")
    block.save("slgaussian-cache", overwrite=True)
    return block
