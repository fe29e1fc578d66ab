"""Just-in-time compilation of kernels by Numba, cached on disk and without the GIL."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile ``function`` with Numba on its first call with arguments of new types.

    A decorator, with or without options of :func:`numba.njit`. Compiled code is cached on disk and
    releases the GIL while it runs, so that concurrent scenes do not wait for each other. Division
    follows NumPy, also by zero, because checks would keep loops scalar. The C wrapper is left out,
    as it is unused and takes time to compile.

    Kernels run on the calling thread; :func:`slgaussian.kernels.work_sharing.share` runs one on
    several threads.
    """
    decorator = numba.njit(
        cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options
    )
    return decorator if function is None else decorator(function)
