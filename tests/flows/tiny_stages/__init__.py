"""Stages of a few bytes, to watch the machinery and not the method."""

import os
import signal
from pathlib import Path

import numpy as np


def labels(value: int) -> dict[str, np.ndarray]:
    full = np.full((1, 4, 5), value, np.int32)
    return {"labels": full, "margin": np.zeros((1, 4, 5), np.float32)}


def note(call, stage: str) -> None:
    """One line in the log for every real execution, which is the last if the call is deadly."""
    if "log" in call.where:
        with Path(call.where["log"]).open("a") as log:
            log.write(f"{call.scene} {stage}\n")
    if call.where.get("deadly") == stage:
        os.kill(os.getpid(), signal.SIGKILL)
    if "deadly once" in call.where and not Path(call.where["deadly once"]).exists():
        Path(call.where["deadly once"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
