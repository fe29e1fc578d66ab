"""Numbers of threads other than that of the machine."""

import contextlib
from collections.abc import Iterator

from slgaussian.kernels import threads


@contextlib.contextmanager
def kernels_on(count: int) -> Iterator[None]:
    """Run kernels of the calling thread on ``count`` threads within the block."""
    before, threads.pool.size = threads.pool.size, count
    try:
        yield
    finally:
        threads.pool.size = before
