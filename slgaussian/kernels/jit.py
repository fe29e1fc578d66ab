"""How functions become machine code here: once a machine, and without the lock of Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Have Numba compile ``function`` when it is first called with arguments of such types.

    A decorator, with or without options of :func:`numba.njit`. What is compiled is kept on disk,
    and lets go of Python's lock while it runs, so that scenes side by side do not wait for each
    other. Division is NumPy's, by zero too: no check keeps a loop scalar. There is no way into it
    from C, which nobody uses and everybody would wait for.

    Kernels run on the thread that calls them; :func:`slgaussian.kernels.work_sharing.share` has
    several threads call one.
    """
    made = numba.njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)
    return made if function is None else made(function)
