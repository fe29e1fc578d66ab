"""Times to be compared with each other: everyone draws in every round."""

import time
from collections.abc import Callable

import numpy as np

ROUNDS = 11
LEAST = 3
SECONDS = 8.0


def race(contenders: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median seconds of each, drawn in turn so that a busy machine is busy for all.

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
            start = time.perf_counter()
            draw()
            spent[name].append(time.perf_counter() - start)
    return {name: float(np.median(seconds)) for name, seconds in spent.items()}
