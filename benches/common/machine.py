"""What a bench ran on, in a line."""

import platform

import numba
import torch

from slgaussian.kernels import threads


def machine() -> str:
    name, cores = threads.processor().rsplit(", ", 1)
    return (
        f"{cores} ({platform.machine()}, {name}), Python "
        f"{platform.python_version()}, torch {torch.__version__}, Numba {numba.__version__}"
    )
