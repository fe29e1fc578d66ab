"""A stage: a Prefect task whose result is looked up in the store by what it depends on.

Results are not left to Prefect. A record of Prefect's names the code that reads it back, pickle
among it, whatever serialiser the task has: who may write to the store could have any code run. So
the records are ours (:mod:`slgaussian.storage.records`), and a stage that is found in them ends in
a state that Prefect's page shows as ``Cached``.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import update_wrapper
from typing import Any, TypeVar

from prefect import Task
from prefect.cache_policies import NO_CACHE
from prefect.states import Completed, State

from slgaussian.benchmark.resident_memory import Peak
from slgaussian.kernels import compiling, threads
from slgaussian.storage.provenance import Made, making
from slgaussian.storage.records import Records
from slgaussian.storage.store import Arrays, ArtifactRef, ArtifactStore, DamagedError
from tasks.events import Finished, Listener, Repeated, Said, Started
from tasks.keys import cache_key, canonical

Read = TypeVar("Read")


@dataclass
class Worksite:
    """Where the stages of one scene are worked on, and what has been made of it so far.

    Attributes
    ----------
    store : ArtifactStore
    scene : str
        What the scene is called, in Prefect's page and in events.
    workers : int
        How many scenes are worked on at the same time on this machine.
    listener : callable
        Hears every :class:`Event`.
    made : {stage: ArtifactRef}
        What the stages of this scene made, or had made before.
    stage, key : str
        The stage that is being worked on, and its cache key.
    """

    store: ArtifactStore
    scene: str = ""
    workers: int = 1
    listener: Listener = lambda event: None
    made: dict[str, ArtifactRef] = field(default_factory=dict)
    stage: str = ""
    key: str = ""
    _known: dict[Hashable, Any] = field(default_factory=dict)

    def read(self, ref: ArtifactRef, made_of: Callable[[Arrays], Read]) -> Read:
        """What ``made_of`` makes of a stored artifact; see :meth:`once`."""
        return self.once((ref.digest, made_of), lambda: made_of(self.store.get(ref)))

    def once(self, what: Hashable, make: Callable[[], Read]) -> Read:
        """What ``make`` makes: once for each ``what``, however many stages of the scene ask for it.

        It is shared between them, so none may change it.
        """
        if what not in self._known:
            self._known[what] = make()
        return self._known[what]

    def tell(self, text: str) -> None:
        """Say how far the stage that is being worked on has come."""
        self.listener(Said(self.scene, self.stage, text))


_site: ContextVar[Worksite] = ContextVar("site")


def current() -> Worksite:
    """Where the road that is being taken is worked on."""
    return _site.get()


@contextmanager
def at(site: Worksite) -> Iterator[None]:
    """Have the stages that are called within the block be worked on there."""
    token = _site.set(site)
    try:
        yield
    finally:
        _site.reset(token)


class Stage:
    """A function from small arguments to one artifact, as a Prefect task; made by :func:`stage`.

    It goes to workers by its name, as a function does.

    It is called with all parameters of the function but the first, which is the
    :class:`Worksite`. Artifacts go in as :class:`ArtifactRef`, files from outside and parts of the
    method as what knows its content (:func:`tasks.keys.canonical`). Returns the ref of what was
    made, whose ``meta`` says what settings made it of which ``inputs``, how many ``seconds`` that
    took on which ``processor`` while how many ``workers`` shared it, and how many
    ``processor_seconds`` of the whole process, both without those of ``compiling`` kernels, and by
    how many bytes at most memory had ``grown``, None where that is not known. It has the
    ``stage_version``, and is ``cached`` if it was found made. The files that the stage writes say
    the stage, its version and the settings.
    """

    __qualname__: str  # that of the function, by which it is sent

    def __init__(
        self, work: Callable[..., ArtifactRef], name: str, version: int, unkeyed: Collection[str]
    ) -> None:
        update_wrapper(self, work)
        self.work, self.name, self.version, self.unkeyed = work, name, version, unkeyed
        self.signature = inspect.signature(work)
        self.task = Task(
            self._found_or_made,
            name=name,
            task_run_name=lambda: f"{name} of {_site.get().scene}",
            cache_policy=NO_CACHE,
            persist_result=False,
        )

    def __reduce__(self) -> str:
        return str(self.work.__qualname__)

    def __call__(self, *args: Any, **kwargs: Any) -> ArtifactRef:
        """What the function makes of these arguments, now or in an earlier run.

        Raises
        ------
        InputError
            If an argument has no canonical form, and as the function.
        DamagedError
            If a stored artifact that it reads is damaged or gone; what is left of it is removed.
        """
        site = _site.get()
        before = site.made.get(self.name)
        site.stage = self.name
        if before is None:
            site.listener(Started(site.scene, self.name))
        bound = self.signature.bind(site, *args, **kwargs)
        bound.apply_defaults()
        _, *given = bound.arguments.items()
        start = time.perf_counter()
        cached = isinstance(self.task(dict(given)), State)
        if before is not None and not cached:
            site.listener(Repeated(site.scene, self.name))
        if before is None or not cached:
            seconds = time.perf_counter() - start
            site.listener(Finished(site.scene, self.name, seconds, cached))
        return site.made[self.name]

    def key(self, arguments: Mapping[str, Any]) -> str:
        """The cache key of a call with these arguments; raises InputError if there is none."""
        counted = {name: value for name, value in arguments.items() if name not in self.unkeyed}
        return cache_key(self.name, self.version, counted)

    def _found_or_made(self, arguments: dict[str, Any]) -> State | None:
        site = _site.get()
        site.key = self.key(arguments)
        records = Records(site.store)
        found = records.find(site.key)
        if found is not None:
            known = {**found.meta, "stage_version": self.version, "cached": True}
            site.made[self.name] = replace(found, meta=known)
            return Completed(name="Cached", message="found in the store")
        settings, inputs = self._parted(arguments)
        of = {name: ref.spec for name, ref in inputs.items()}
        given = frozenset(ref.digest for ref in inputs.values())
        made = Made(self.name, self.version, settings, of, given)
        threads.limit(site.workers)
        compiling.watch()
        peak, compiled = Peak(), compiling.spent()
        start, worked = compiling.clock(), time.process_time()
        try:
            with compiling.told_to(site.tell), making(made), peak.watched():
                ref = self.work(site, **arguments)
        except DamagedError as error:
            # Then the stage that made it makes it again.
            site.store.remove([error.uri])
            raise
        took = {
            "seconds": compiling.clock() - start,
            "processor_seconds": time.process_time() - worked - compiling.spent() + compiled,
            "compiling": compiling.spent() - compiled,
            "grown": peak.grown,
            "processor": threads.processor(),
            "workers": site.workers,
        }
        known = {"settings": settings, "inputs": {n: own.digest for n, own in inputs.items()}}
        ref = replace(ref, meta={**ref.meta, **known, **took})
        records.keep(site.key, ref)
        site.made[self.name] = replace(ref, meta={**ref.meta, "stage_version": self.version})
        return None

    def _parted(
        self, arguments: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, ArtifactRef]]:
        """The arguments that are settings, as plain data, and those that are artifacts."""
        counted = {name: value for name, value in arguments.items() if name not in self.unkeyed}
        inputs = {name: own for name, own in counted.items() if isinstance(own, ArtifactRef)}
        rest = {name: own for name, own in counted.items() if name not in inputs}
        return {name: canonical(own, name) for name, own in rest.items()}, inputs


def stage(
    name: str, version: int, unkeyed: Collection[str] = ()
) -> Callable[[Callable[..., ArtifactRef]], Stage]:
    """Make a function a :class:`Stage`.

    Parameters
    ----------
    name : str
    version : int
        Raised by hand whenever the same arguments would give another result.
    unkeyed : collection of str
        The parameters that say where or how, and never what.
    """
    return lambda work: Stage(work, name, version, unkeyed)
