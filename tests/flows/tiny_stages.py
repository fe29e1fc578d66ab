"""Stages of a few bytes and their road, to watch the machinery and not the method."""

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
    full = np.full((1, 4, 5), value, np.int32)
    return {"labels": full, "margin": np.zeros((1, 4, 5), np.float32)}


class Where(dict):
    """What a stage does besides its work, which is no part of its cache key."""

    def identity(self) -> dict:
        return {}


def note(run: RunContext, where: Where) -> None:
    """One line in the log for every real execution, which is the last if the call is deadly."""
    if "log" in where:
        with Path(where["log"]).open("a") as log:
            log.write(f"{run.scene} {run.stage}\n")
    if where.get("deadly") == run.stage:
        os.kill(os.getpid(), signal.SIGKILL)
    if "deadly once" in where and not Path(where["deadly once"]).exists():
        Path(where["deadly once"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(float(where.get("sleep", 0)))


@stage("make", version=1)
def make(run: RunContext, value: int, where: Where) -> ArtifactRef:
    note(run, where)
    if value < 0:
        raise InputError(f"value {value}: expected a positive number")
    if value == 666:
        raise ZeroDivisionError("a defect")
    if value == 667:
        raise SystemExit(3)
    return run.store.put("labels", labels(value))


@stage("halve", version=1)
def halve(run: RunContext, output: ArtifactRef, where: Where) -> ArtifactRef:
    """Half, rounded down: 4 and 5 give the same."""
    note(run, where)
    value = int(run.store.get(output)["labels"].max())
    return run.store.put("labels", labels(value // 2))


@stage("add", version=1)
def add(run: RunContext, half: ArtifactRef, extra: int, where: Where) -> ArtifactRef:
    note(run, where)
    value = int(run.store.get(half)["labels"].max())
    return run.store.put("labels", labels(value + extra))


def tiny_pipeline(value: int, extra: int, given: dict[str, str]) -> None:
    where = Where(given)
    output = make(value, where)
    half = halve(output, where)
    add(half, extra, where)
