"""Majority vote over replicas (paper section 3.2, S_i(v) = argmax over x of count(x))."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def vote(stack: np.ndarray, times: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Compute the per-pixel majority of label maps of R replicas.

    Label 0 (no object) counts like any other, as in the paper's formula. Ties go to the first label
    in replica order: that of the detection, then of its earliest propagation.

    Args:
        stack: int32 [R, H, W]. One label map per replica, R at least 1.
        times: sequence of int, optional. Weight of each map, if it stands for several equal
            replicas; R is then the sum of weights.

    Returns:
        labels: int32 [H, W]
        margin: float32 [H, W]. (votes for the winner - votes for the runner-up) / R, in [0, 1]; 1
            if unanimous.
    """
    weights = np.ones(len(stack), np.int32) if times is None else np.array(times, np.int32)
    counts = np.stack([np.tensordot(weights, stack == replica, 1) for replica in stack])
    first = counts.argmax(0)[None]  # argmax returns the first maximum, as ties require
    labels = np.take_along_axis(stack, first, 0)[0]
    winner = counts.max(0)
    runner_up = np.where(stack == labels, 0, counts).max(0)
    return labels, ((winner - runner_up) / weights.sum()).astype(np.float32)
