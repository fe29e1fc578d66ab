"""Several threads that run one kernel, and take its work from it portion by portion.

A kernel that can be shared begins with a ``counter`` and goes on to :func:`take` the next portion
until there is none. Handed out beforehand, all would wait for the slowest: on a machine that does
other work as well, for a thread that is not even running. What a portion computes must not depend
on who takes it; then nor do the results.

The threads are Python's own, as kernels let go of its lock. They wait asleep, whoever calls may
share, also side by side, and a kernel for one thread compiles faster than a ``parallel`` one.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from slgaussian.kernels import threads


@intrinsic
def take(typing, counter):
    """The number in ``counter``, int64 [1], which goes up by one: each number is taken once.

    Numba does not see that it changes; do not read it after the loop.
    """

    def lower(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        one = ir.Constant(ir.IntType(64), 1)
        return builder.atomic_rmw("add", data, one, "monotonic")

    return types.int64(counter), lower


def share(kernel: Callable[..., Any], portions: int, *args: Any) -> None:
    """Have threads call ``kernel(counter, *args)`` until its ``portions`` are done.

    This thread is one of them; :func:`slgaussian.kernels.threads.allotted` says how many it may
    use.
    """
    counter = np.zeros(1, np.int64)
    count = min(threads.allotted(), portions) - 1
    helpers = [_pool().submit(copy_context().run, kernel, counter, *args) for _ in range(count)]
    try:
        kernel(counter, *args)
    finally:
        # One that has not even begun is not waited for: nothing is left to do.
        for helper in helpers:
            if not helper.cancel():
                helper.result()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, threads.cores() - 1), "slgaussian-kernel")


os.register_at_fork(after_in_child=_pool.cache_clear)  # a fork has none of its parent's threads
