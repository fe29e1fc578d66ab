"""Three stages of a few bytes and their pipeline, to test how stages run."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactRef
from tasks.context import RunContext
from tasks.stage import stage


def labels(value: int) -> dict[str, np.ndarray]:
    return {
        "labels": np.full((1, 4, 5), value, np.int32),
        "margin": np.zeros((1, 4, 5), np.float32),
    }


class Effects(dict):
    """Side effects of a stage, which are no part of its cache key."""

    def identity(self) -> dict:
        return {}


def note(run: RunContext, effects: Effects) -> None:
    """Log the execution; then kill the process if this stage is deadly, or sleep."""
    if "log" in effects:
        with Path(effects["log"]).open("a") as log:
            log.write(f"{run.scene} {run.stage}\n")
    if effects.get("deadly") == run.stage:
        os.kill(os.getpid(), signal.SIGKILL)
    if "deadly once" in effects and not Path(effects["deadly once"]).exists():
        Path(effects["deadly once"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(float(effects.get("sleep", 0)))


@stage("make", version=1)
def make(run: RunContext, value: int, where: Effects) -> ArtifactRef:
    note(run, where)
    if value < 0:
        raise InputError(f"value {value}: expected a positive number")
    if value == 666:
        raise ZeroDivisionError("a defect")
    if value == 667:
        raise SystemExit(3)
    return run.store.put("labels", labels(value))


@stage("halve", version=1)
def halve(run: RunContext, output: ArtifactRef, where: Effects) -> ArtifactRef:
    """Half, rounded down: 4 and 5 give the same."""
    note(run, where)
    value = int(run.store.get(output)["labels"].max())
    return run.store.put("labels", labels(value // 2))


@stage("add", version=1)
def add(run: RunContext, half: ArtifactRef, extra: int, where: Effects) -> ArtifactRef:
    note(run, where)
    value = int(run.store.get(half)["labels"].max())
    return run.store.put("labels", labels(value + extra))


def tiny_pipeline(value: int, extra: int, effects: dict[str, str]) -> None:
    effects = Effects(effects)
    output = make(value, effects)
    half = halve(output, effects)
    add(half, extra, effects)
