"""The vote over replicas (paper section 3.2, S_i(v) = argmax over x of count(x))."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slgaussian.errors import InputError


def vote(stack: np.ndarray, times: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Per-pixel majority of label maps of R replicas.

    Label 0 ("no object here") is counted like any other, as the paper's formula has it. Among
    labels with equally many votes the one that comes first in replica order wins: that of the
    detection itself, then of its earliest propagation.

    Parameters
    ----------
    stack : int32 [R, H, W]
        One label map a replica, R at least 1.
    times : sequence of int, optional
        How often each map counts, where replicas are equal; their sum is R then.

    Returns
    -------
    labels : int32 [H, W]
    margin : float32 [H, W]
        (votes for the winner - votes for the runner-up) / R, in [0, 1]; 1 where all agree.

    Raises
    ------
    InputError
        If ``stack`` has the wrong type or shape, or no replica.
    """
    if stack.dtype != np.int32 or stack.ndim != 3 or stack.shape[0] == 0:
        raise InputError(
            f"vote: found {stack.dtype} {stack.shape}, expected int32 [R, H, W] with R at least 1"
        )
    each = np.ones(len(stack), np.int32) if times is None else np.array(times, np.int32)
    counts = np.stack([np.tensordot(each, stack == replica, 1) for replica in stack])
    first = counts.argmax(0)[None]  # argmax takes the first of equals: the tie rule
    labels = np.take_along_axis(stack, first, 0)[0]
    won = counts.max(0)
    runner_up = np.where(stack == labels, 0, counts).max(0)
    return labels, ((won - runner_up) / each.sum()).astype(np.float32)
