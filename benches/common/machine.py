"""What a bench ran on, in a line."""

import platform
from pathlib import Path

import numba
import torch

from slgaussian.kernels import threads


def machine() -> str:
    info = Path("/proc/cpuinfo").read_text()
    models = [line.split(":")[1] for line in info.splitlines() if line.startswith("model name")]
    model = models[0].replace("(R)", "").replace("(TM)", "").strip() if models else "processor"
    return (
        f"{threads.cores()} cores ({platform.machine()}, {model}), Python "
        f"{platform.python_version()}, torch {torch.__version__}, Numba {numba.__version__}"
    )
