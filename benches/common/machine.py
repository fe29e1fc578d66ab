"""When, of which commit and on which machine something was measured, in a line."""

import platform
import subprocess
from datetime import date
from pathlib import Path

import numba
import torch

from slgaussian.kernels import threads

ROOT = Path(__file__).parents[2]
CODE = ("slgaussian", "flows", "tasks", "data_specs", "benches")


def measured() -> str:
    """Date, commit and machine, the one sentence that each page of ``docs/measured/`` begins with.

    Raises
    ------
    subprocess.CalledProcessError
        Outside a clone of the repository.
    """
    commit = _git("rev-parse", "--short", "HEAD")
    if _git("status", "--porcelain", "--", *CODE):
        commit += " with changes"
    return f"Measured on {date.today()}, commit {commit}, on {machine()}."


def machine() -> str:
    """Processor, cores and versions; no name of the machine."""
    name, cores = threads.processor().rsplit(", ", 1)
    return (
        f"{cores} ({platform.machine()}, {name}), Python "
        f"{platform.python_version()}, torch {torch.__version__}, Numba {numba.__version__}"
    )


def _git(*words: str) -> str:
    command = ["git", "-C", str(ROOT), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
