"""A road taken without doing the work: what each of its stages would be called with."""

from typing import Any

import pytest

from flows.runners.shard import Job
from slgaussian.storage.store import ArtifactRef
from tasks.keys import canonical
from tasks.stage import Stage


def calls_of(job: Job, monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, Any]]:
    """The arguments of every stage on the road of a job, by the stage's name."""
    calls = {}

    def called(stage: Stage, *args, **kwargs) -> ArtifactRef:
        bound = stage.signature.bind(None, *args, **kwargs)
        bound.apply_defaults()
        _, *given = bound.arguments.items()
        calls[stage.name] = dict(given)
        return ArtifactRef(stage.name, f"{stage.name}/x", "x", {"targets": []})

    with monkeypatch.context() as patch:
        patch.setattr(Stage, "__call__", called)
        job.road(*job.arguments)
    return calls


def keyed(arguments: dict[str, Any]) -> dict[str, Any]:
    """What of the arguments of a stage is in its cache key."""
    return {name: canonical(value, name) for name, value in arguments.items()}
