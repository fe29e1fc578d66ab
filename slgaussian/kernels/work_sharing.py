"""Dynamic scheduling of the work items of a kernel over several threads.

The first argument of a shared kernel is a ``counter``, from which each thread calls :func:`take`
for its next work item until none is left. With a static partition all threads would wait for the
slowest, which on a busy machine may not even run. The result of an item must not depend on the
thread that computes it; then the results do not depend on the number of threads.

The threads are Python threads, as kernels release the GIL. They sleep while idle, several callers
can share at the same time, and a single-threaded kernel compiles faster than a ``parallel`` one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import cache
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from slgaussian.kernels import threads
from slgaussian.system import after_fork

T = TypeVar("T")


@intrinsic
def take(typing, counter):
    """Return the number in ``counter``, int64 [1], and increment it atomically.

    Numba is not aware of the change; do not read the counter after the loop.
    """

    def lower(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        increment = ir.Constant(ir.IntType(64), 1)
        return builder.atomic_rmw("add", data, increment, "monotonic")

    return types.int64(counter), lower


def share(kernel: Callable[..., Any], portions: int, *args: Any) -> None:
    """Run ``kernel(counter, *args)`` on several threads until its ``portions`` are done.

    The calling thread is one of :class:`slgaussian.kernels.threads.Pool` ``.size`` threads.
    """
    counter = np.zeros(1, np.int64)
    count = min(threads.pool.size, portions) - 1
    helpers = [_pool().submit(copy_context().run, kernel, counter, *args) for _ in range(count)]
    try:
        kernel(counter, *args)
    finally:
        # A helper that has not begun is cancelled: no work is left.
        for helper in helpers:
            if not helper.cancel():
                helper.result()


def share_items(function: Callable[..., T], *arguments: Iterable[Any]) -> list[T]:
    """Apply ``function`` to items on several threads, as ``map`` does; return results in order.

    Items gain by it as far as they release the GIL: kernels, OpenCV and large NumPy operations do.
    A result must not depend on the order of the items.
    """
    items = list(zip(*arguments, strict=True))
    results: list[Any] = [None] * len(items)
    numbers = iter(range(len(items)))

    def work(counter: np.ndarray) -> None:
        for number in numbers:  # a range iterator gives each number to one thread
            results[number] = function(*items[number])

    share(work, len(items))
    return results


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, threads.cores() - 1), "slgaussian-kernel")


after_fork(_pool.cache_clear)  # a fork has none of its parent's threads
