"""Times to be compared with each other: everyone draws in every round."""

import time
from collections.abc import Callable

import numpy as np

ROUNDS = 11
LEAST = 3
SECONDS = 8.0


def paired_times(
    contenders: dict[str, Callable[[], object]],
    clock: Callable[[], float] = time.perf_counter,
    pick: Callable = np.median,
) -> dict[str, float]:
    """Median seconds of each by ``clock``, in turn so that a busy machine is busy for all.

    ``pick`` may take another of them: the least is what the work takes where others interrupt.

    After one round that does not count there are ``ROUNDS``, or fewer, at least ``LEAST``, where
    they would take longer than ``SECONDS`` together.
    """
    spent: dict[str, list[float]] = {name: [] for name in contenders}
    for draw in contenders.values():
        draw()
    begun = time.perf_counter()
    for done in range(ROUNDS):
        if done >= LEAST and time.perf_counter() - begun > SECONDS:
            break
        for name, draw in contenders.items():
            start = clock()
            draw()
            spent[name].append(clock() - start)
    return {name: float(pick(seconds)) for name, seconds in spent.items()}
