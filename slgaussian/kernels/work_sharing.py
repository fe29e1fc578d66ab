"""Handing out work to the threads of a Numba function, one portion at a time.

``prange`` gives each thread its part beforehand, and then all wait for the slowest: on a machine
that does other work as well, for a thread that is not even running. So run :data:`WORKERS`
iterations, and let each :func:`take` the next portion until there is none; with fewer threads the
later iterations find nothing to do. What a portion computes must not depend on who takes it; then
nor do the results.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

WORKERS = 256
"""As many as a machine may have threads."""


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
