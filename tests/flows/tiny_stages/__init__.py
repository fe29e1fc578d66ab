"""Stages of a few bytes, to watch the machinery and not the method."""

from pathlib import Path

import numpy as np


def labels(value: int) -> dict[str, np.ndarray]:
    full = np.full((1, 4, 5), value, np.int32)
    return {"labels": full, "margin": np.zeros((1, 4, 5), np.float32)}


def note(call, stage: str) -> None:
    """One line in the log for every real execution."""
    if "log" in call.where:
        with Path(call.where["log"]).open("a") as log:
            log.write(f"{call.scene} {stage}\n")
