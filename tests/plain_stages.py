"""Stages without Prefect."""

from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.context import RunContext, run_context
from tasks.stage import Stage


def call(stage: Stage, store, **arguments) -> tuple[ArtifactRef, bool]:
    """Call a stage; return its result, and whether it was in the store."""
    plain, events = Stage(stage.compute, stage.name, stage.version), []
    plain.task = lambda inputs, quoted, refresh: stage.task.fn(inputs, quoted.unwrap(), refresh)
    with run_context(RunContext(ArtifactStore(str(store)), notify=events.append)):
        ref = plain(**arguments)
    return ref, events[-1].state == "cached"
