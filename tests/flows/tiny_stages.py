"""Stages of a few bytes and their road, to watch the machinery and not the method."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactRef
from tasks.stage import Worksite, stage


def labels(value: int) -> dict[str, np.ndarray]:
    full = np.full((1, 4, 5), value, np.int32)
    return {"labels": full, "margin": np.zeros((1, 4, 5), np.float32)}


def note(site: Worksite, where: dict[str, str]) -> None:
    """One line in the log for every real execution, which is the last if the call is deadly."""
    if "log" in where:
        with Path(where["log"]).open("a") as log:
            log.write(f"{site.scene} {site.stage}\n")
    if where.get("deadly") == site.stage:
        os.kill(os.getpid(), signal.SIGKILL)
    if "deadly once" in where and not Path(where["deadly once"]).exists():
        Path(where["deadly once"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(float(where.get("sleep", 0)))


@stage("make", version=1, unkeyed=("where",))
def make(site: Worksite, value: int, where: dict[str, str]) -> ArtifactRef:
    note(site, where)
    if value < 0:
        raise InputError(f"value {value}: expected a positive number")
    if value == 666:
        raise ZeroDivisionError("a defect")
    if value == 667:
        raise SystemExit(3)
    return site.store.put("labels", labels(value))


@stage("halve", version=1, unkeyed=("where",))
def halve(site: Worksite, made: ArtifactRef, where: dict[str, str]) -> ArtifactRef:
    """Half, rounded down: 4 and 5 give the same."""
    note(site, where)
    value = int(site.store.get(made)["labels"].max())
    return site.store.put("labels", labels(value // 2))


@stage("add", version=1, unkeyed=("where",))
def add(site: Worksite, half: ArtifactRef, more: int, where: dict[str, str]) -> ArtifactRef:
    note(site, where)
    value = int(site.store.get(half)["labels"].max())
    return site.store.put("labels", labels(value + more))


def tiny_road(value: int, more: int, where: dict[str, str]) -> None:
    made = make(value, where)
    half = halve(made, where)
    add(half, more, where)
