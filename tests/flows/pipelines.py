"""A pipeline without the work: what each of its stages would be called with."""

from typing import Any

import pytest

from flows.runners.batches import SceneTask
from slgaussian.storage.store import ArtifactRef
from tasks.stage import Stage, canonical


def calls_of(scene_task: SceneTask, monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, Any]]:
    """The arguments of every stage of a pipeline, by the stage's name."""
    calls = {}

    def called(stage: Stage, *args, **kwargs) -> ArtifactRef:
        bound = stage.signature.bind(None, *args, **kwargs)
        bound.apply_defaults()
        _, *inputs = bound.arguments.items()
        calls[stage.name] = dict(inputs)
        return ArtifactRef(stage.name, f"{stage.name}/x", "x", {"targets": []})

    with monkeypatch.context() as patch:
        patch.setattr(Stage, "__call__", called)
        scene_task.pipeline(*scene_task.arguments)
    return calls


def keyed(arguments: dict[str, Any]) -> dict[str, Any]:
    """What of the arguments of a stage is in its cache key."""
    return {name: canonical(value, name) for name, value in arguments.items()}
