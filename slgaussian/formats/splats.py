"""Files of Gaussians of any program, read and written by their suffix."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.errors import InputError, did_you_mean
from slgaussian.formats.low_pass import include_low_pass
from slgaussian.gaussians import Gaussians
from slgaussian.scene import Camera

READERS = {
    ".ply": "slgaussian.formats.ply:load_ply",
    ".spz": "slgaussian.formats.spz:load_spz",
}
"""Functions by suffix: (path) -> Gaussians, and further columns {name: [N]}."""

WRITERS = {
    ".ply": "slgaussian.formats.ply:save_ply",
    ".spz": "slgaussian.formats.spz:save_spz",
    ".sog": "slgaussian.formats.sog:save_sog",
    ".glb": "slgaussian.formats.glb:save_glb",
    ".rrd": "slgaussian.formats.rrd:save_rrd",
    ".usda": "slgaussian.formats.usd:save_usd",
    ".usdc": "slgaussian.formats.usd:save_usd",
    ".usdz": "slgaussian.formats.usd:save_usd",
}
"""Functions by suffix: (Gaussians, path, labels int [N] or None)."""

WITH_CAMERAS = (".rrd", ".usda", ".usdc", ".usdz")
"""Formats that also hold the cameras of the views, {name: Camera}."""


def load_gaussians(path: str | Path) -> tuple[Gaussians, dict[str, np.ndarray]]:
    """Read Gaussians and the further columns of their file; raises as the reader of its suffix."""
    gaussians, extra = _function(path, READERS)(path)
    return gaussians, extra


def save_gaussians(
    gaussians: Gaussians,
    path: str | Path,
    labels: np.ndarray | None = None,
    cameras: Mapping[str, Camera] | None = None,
    full: bool = False,
    names: Mapping[int, str] | None = None,
) -> None:
    """Write Gaussians atomically, with their objects and cameras where the format has a place.

    Args:
        labels: int [N], optional. Object of each Gaussian, 0 for none.
        cameras: {name: Camera}, optional. The context cameras of a field: the file is then for
            viewers (:func:`slgaussian.formats.low_pass.include_low_pass`), unless ``full``.
        full: Write the columns of this project too, which only a ``.ply`` holds.
        names: {label: str}, optional. Names of the objects, which only a ``.glb`` holds.

    Raises:
        InputError: If the suffix names no format, or none that ``full`` is for, and as the writer
            of the suffix.
    """
    write, suffix = _function(path, WRITERS), Path(path).suffix.lower()
    if full and suffix != ".ply":
        raise InputError(f"{path}: full is for .ply files; leave it out")
    if cameras and not full:
        gaussians = include_low_pass(gaussians, list(cameras.values()))
    options: dict[str, Any] = {".ply": {"full": full}, ".glb": {"names": names}}
    options |= {each: {"cameras": cameras} for each in WITH_CAMERAS}
    write(gaussians, path, labels, **options.get(suffix, {}))


def _function(path: str | Path, table: dict[str, str]) -> Any:
    suffix = Path(path).suffix.lower()
    if suffix not in table:
        *first, last = table
        raise InputError(
            f"{path}: found {repr(suffix) if suffix else 'no suffix'}, expected the name of the "
            f"file to end in {', '.join(first)}{' or ' if first else ''}{last}"
            f"{did_you_mean(suffix, table)}"
        )
    return pkgutil.resolve_name(table[suffix])
