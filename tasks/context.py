"""The run context: where the stages of one scene store, read and report."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, TypeVar

from slgaussian.storage.encoding import Arrays
from slgaussian.storage.store import ArtifactRef, ArtifactStore

Value = TypeVar("Value")


@dataclass(frozen=True)
class StageEvent:
    """A change of state of one stage of one scene.

    Attributes:
        state: ``running``, ``completed``, ``cached`` or ``failed`` (the scene is left out).
        message: Progress within a running stage, or the reason of a failure.
        seconds: Wall time of a completed stage.
        traceback: Of a failure that is a defect.
    """

    scene: str
    stage: str
    state: str
    message: str = ""
    seconds: float = 0.0
    traceback: str = ""


Notify = Callable[[StageEvent], None]


@dataclass
class RunContext:
    """State that the stages of one scene share.

    Attributes:
        scene: Name of the scene in events and in Prefect's page.
        workers: Number of concurrent scenes on this machine.
        notify: callable. Receives every :class:`StageEvent`.
        refresh: frozenset of str. Names of stages to recompute, with the stages that depend on
            them.
        look_up: Compute nothing: the first stage without a stored result raises NotStoredError.
        refs: {stage: ArtifactRef}. Results of the stages so far.
        stage, key: The running stage and its cache key.
        results: {digest: StageResult}. The same results as Prefect task results.
    """

    store: ArtifactStore
    scene: str = ""
    workers: int = 1
    notify: Notify = lambda event: None
    refresh: frozenset[str] = frozenset()
    look_up: bool = False
    refs: dict[str, ArtifactRef] = field(default_factory=dict)
    stage: str = ""
    key: str = ""
    results: dict[str, Any] = field(default_factory=dict)
    _values: dict[Hashable, Any] = field(default_factory=dict)

    def read(self, ref: ArtifactRef, decode: Callable[[Arrays], Value]) -> Value:
        """Decode a stored artifact; see :meth:`once`."""
        return self.once((ref.digest, decode), lambda: decode(self.store.get(ref)))

    def once(self, key: Hashable, compute: Callable[[], Value]) -> Value:
        """Compute a value once for all stages of the scene, none of which may change it."""
        if key not in self._values:
            self._values[key] = compute()
        return self._values[key]

    def report(self, message: str) -> None:
        """Report the progress of the running stage."""
        self.notify(StageEvent(self.scene, self.stage, "running", message))


_context: ContextVar[RunContext] = ContextVar("run_context")


def current_run() -> RunContext:
    """Return the context that stages are called in; LookupError outside :func:`run_context`."""
    return _context.get()


def enclosing_run() -> RunContext | None:
    """Return the context that this code runs in, None in a process that has none."""
    return _context.get(None)


@contextmanager
def run_context(context: RunContext) -> Iterator[RunContext]:
    """Have stages that are called within the block use this context."""
    token = _context.set(context)
    try:
        yield context
    finally:
        _context.reset(token)
