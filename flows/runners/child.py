"""Programs of ours that a program of ours starts, each a module of this package."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any


def begin(module: str, *words: str, **options: Any) -> subprocess.Popen:
    """Start ``module`` as a program that imports what this one imports.

    Neither it nor what it starts itself looks for modules in the working folder, where a user may
    well keep a ``tasks.py``.

    Parameters
    ----------
    module : str
        Its full name.
    *words : str
        Its arguments.
    **options
        Those of :class:`subprocess.Popen`; ``env`` is what its environment has besides ours.
    """
    return subprocess.Popen(
        [sys.executable, "-m", module, *words],
        **{**options, "env": {**os.environ, **options.get("env", {}), **import_path()}},
    )


def import_path() -> dict[str, str]:
    """The variables that have a Python find what this one finds, and look nowhere else."""
    own = str(Path(__file__).resolve().parents[2])
    places = [place for place in sys.path if place]
    if own not in places:  # where '' meant it
        places.insert(0, own)
    return {"PYTHONPATH": os.pathsep.join(places), "PYTHONSAFEPATH": "1"}
