"""Stages: cached Prefect tasks from refs and settings to one artifact.

The cache key is a canonical form of all inputs. Results are not persisted by Prefect: its records
name the code that deserialises them, including pickle, whatever serializer a task has, so that
write access to the store would allow code execution. Records are in
:mod:`slgaussian.storage.records` instead. They are looked up first: only a stage that is computed
has a Prefect task, which costs the server's database 25 kB.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import update_wrapper
from typing import Any

from prefect import Task
from prefect.cache_policies import NO_CACHE
from prefect.utilities.annotations import quote

from slgaussian.components.config import ComponentConfig, Config
from slgaussian.errors import InputError
from slgaussian.io import KnownFile
from slgaussian.kernels import compiling, threads
from slgaussian.storage.provenance import Provenance, record_provenance
from slgaussian.storage.records import NotStoredError, Records
from slgaussian.storage.store import ArtifactRef, DamagedError
from tasks.context import StageEvent, current_run


def cache_key(stage: str, version: int, arguments: Mapping[str, Any]) -> str:
    """Return the cache key ``<stage>/v<version>/<sha256>``.

    Two keys are equal if and only if stage, version and the content of the arguments are. The order
    of keys, the process, and the locations of files and store have no effect.

    Raises:
        InputError: If an argument has no canonical form (see :func:`canonical`).
    """
    content = {name: canonical(value, name) for name, value in arguments.items()}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"{stage}/v{version}/{hashlib.sha256(text.encode()).hexdigest()}"


def canonical(value: Any, name: str = "value") -> Any:
    """Convert ``value`` to plain JSON data; refs become spec and digest, tuples become lists.

    A dataclass or config becomes its fields. External data and components of the method have a
    method ``identity`` that returns such data.

    Raises:
        InputError: For values without a canonical form: arrays (pass a ref), paths (the file may
            change; use its digest), sets, generators, NaN and objects.
    """
    if value is None or isinstance(value, (bool, str)) or type(value) is int:
        return value
    if type(value) is float and math.isfinite(value):
        return value
    if isinstance(value, ArtifactRef):
        return {"spec": value.spec, "digest": value.digest}
    if isinstance(value, KnownFile):
        return value.digest
    if isinstance(value, ComponentConfig):
        return {value.name: canonical(value.identity(), name)}
    if hasattr(value, "identity"):
        return canonical(value.identity(), name)
    if is_dataclass(value) and not isinstance(value, type):
        return canonical(_fields(value), name)
    if isinstance(value, Config):
        return canonical(dict(value), name)
    if isinstance(value, (list, tuple)):
        return [canonical(item, f"{name}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        # Sorted, because files contain the settings in this order.
        return {key: canonical(value[key], f"{name}.{key}") for key in sorted(value)}
    raise InputError(
        f"{name}: {type(value).__name__} {value!r:.60} cannot be part of a cache key; expected "
        "plain numbers, text, lists, tables with text keys, or artifact refs"
    )


class StageResult:
    """Result of a stage as a Prefect task result.

    Prefect recognises it among the inputs of another stage by object identity. It traverses
    dataclasses; this is none, so that the object itself is recognised.
    """

    def __init__(self, ref: ArtifactRef) -> None:
        self.ref = ref


class Stage:
    """A cached function from small arguments to one artifact, made by :func:`stage`.

    It is called with all parameters of the function except the first, the :class:`RunContext`.
    Artifacts are passed as :class:`ArtifactRef`, so that Prefect's graph has edges between the
    stages that are computed.
    External files and components are passed as objects with an identity
    (:func:`tasks.stage.canonical`).

    Returns the ref of the result. Its ``meta`` has the ``settings``, the digests of ``inputs``, the
    ``seconds`` of wall time and ``processor_seconds`` without those of ``compiling`` kernels, the
    number of ``workers``. Files that a stage writes name the stage, its version and the settings.
    """

    __qualname__: str

    def __init__(self, compute: Callable[..., ArtifactRef], name: str, version: int) -> None:
        update_wrapper(self, compute)
        self.compute, self.name, self.version = compute, name, version
        self.signature = inspect.signature(compute)
        self.task = Task(
            self._compute_and_record,
            name=name,
            task_run_name=lambda: f"{name} of {current_run().scene}",
            cache_policy=NO_CACHE,
            persist_result=False,
        )

    def __reduce__(self) -> str:
        return self.compute.__qualname__  # pickled by name, like a function

    def __call__(self, *args: Any, **kwargs: Any) -> ArtifactRef:
        """Return the result for these arguments, from the cache or computed.

        Raises:
            InputError: If an argument has no canonical form, and as the function.
            DamagedError: If a stored artifact that it reads is damaged or missing; the artifact is
                removed.
        """
        run = current_run()
        run.stage = self.name
        run.notify(StageEvent(run.scene, self.name, "running"))
        bound = self.signature.bind(run, *args, **kwargs)
        bound.apply_defaults()
        arguments = dict(list(bound.arguments.items())[1:])
        run.key = cache_key(self.name, self.version, arguments)
        if run.look_up:
            if self.name in run.refresh:
                raise NotStoredError("to be computed anew")
            run.refs[self.name] = ref = Records(run.store).require(run.key)
            return ref
        start = time.perf_counter()
        refs = list(refs_in(arguments))
        refresh = self.name in run.refresh or any(ref.meta.get("refreshed") for ref in refs)
        stored = None if refresh else Records(run.store).find(run.key)
        if stored is None:
            edges = [run.results[ref.digest] for ref in refs if ref.digest in run.results]
            result = self.task(edges, quote(arguments), refresh)  # type: ignore[call-overload]
            run.results[result.ref.digest] = result
        run.refs[self.name] = ref = result.ref if stored is None else stored
        state = "completed" if stored is None else "cached"
        seconds = time.perf_counter() - start
        run.notify(StageEvent(run.scene, self.name, state, seconds=seconds))
        return ref

    def _compute_and_record(
        self, inputs: list[StageResult], arguments: dict[str, Any], refresh: bool
    ) -> StageResult:
        """Run as a Prefect task, with ``inputs`` for its graph."""
        run = current_run()
        refs = {n: value for n, value in arguments.items() if isinstance(value, ArtifactRef)}
        settings = {n: canonical(value, n) for n, value in arguments.items() if n not in refs}
        specs = {name: ref.spec for name, ref in refs.items()}
        digests = {name: ref.digest for name, ref in refs.items()}
        passed = frozenset(digests.values())
        provenance = Provenance(self.name, self.version, settings, specs, passed)
        threads.limit(run.workers)
        compiled, start, worked = compiling.spent(), time.perf_counter(), time.process_time()
        try:
            with record_provenance(provenance):
                ref = self.compute(run, **arguments)
        except DamagedError as error:
            run.store.remove([error.uri])  # so that its stage computes it again
            raise
        compiled = compiling.spent() - compiled
        cost = {
            "seconds": time.perf_counter() - start - compiled,
            "processor_seconds": time.process_time() - worked - compiled,
            "compiling": compiled,
            "workers": run.workers,
        }
        ref = replace(ref, meta={**ref.meta, "settings": settings, "inputs": digests, **cost})
        Records(run.store).keep(run.key, ref)
        if refresh:
            ref = replace(ref, meta={**ref.meta, "refreshed": True})
        return StageResult(ref)


def stage(name: str, version: int) -> Callable[[Callable[..., ArtifactRef]], Stage]:
    """Make a function a :class:`Stage`.

    ``version`` is to be increased when the same arguments give another result.
    """
    return lambda compute: Stage(compute, name, version)


def refs_in(value: Any) -> Iterator[ArtifactRef]:
    """Yield the refs in a value, within sequences, mappings and dataclasses too."""
    if isinstance(value, ArtifactRef):
        yield value
        return
    if is_dataclass(value) and not isinstance(value, type):
        value = _fields(value)
    items = value.values() if isinstance(value, Mapping) else value
    if isinstance(value, (Mapping, list, tuple)):
        for item in items:
            yield from refs_in(item)


def _fields(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in fields(value)}
