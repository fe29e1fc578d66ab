"""Files of found cameras, in the formats of other programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.datasets import colmap_writer, llff, nerfstudio
from slgaussian.datasets.sparse_model import build_sparse_model
from slgaussian.errors import InputError

SUFFIXES = {"colmap": "", "colmap-text": "", "nerfstudio": ".json", "llff": ".npy"}
"""Suffix of each format, the first with a suffix being the usual one; COLMAP's are folders."""


def check_target(out: Path, format: str | None = None) -> str:
    """Choose the format of ``out``, by its suffix if ``format`` is None, and check that it is free.

    Call it before the work.

    Raises:
        InputError: If there is no such format, the suffix is that of another one, or ``out`` exists
            and was not written by :func:`write_cameras`.
    """
    if format is not None and format not in SUFFIXES:
        raise InputError(f"format: found {format!r}, expected one of {', '.join(SUFFIXES)}")
    suffix = out.suffix.lower()
    fitting = [name for name, expected in SUFFIXES.items() if expected == suffix]
    if not fitting or format not in (None, *fitting):
        expected = "no suffix, as a folder of COLMAP's, .json of nerfstudio's or .npy of LLFF's"
        if format is not None:
            expected = f"{SUFFIXES[format] or 'no suffix'}, as of {format}"
        raise InputError(f"{out}: found {suffix or 'no suffix'}, expected {expected}")
    format = format or fitting[0]
    if not suffix:
        colmap_writer.check_folder(out)
        return format
    try:
        is_foreign = out.exists() and nerfstudio.EXTENSION_KEY.encode() not in out.read_bytes()
    except OSError as error:
        message = f"{out}: cannot be written ({error.strerror}); choose another"
        raise InputError(message) from None
    if is_foreign:
        raise InputError(
            f"{out}: exists and was not written by `slgaussian cameras`; choose another file, or "
            "remove it"
        )
    return format


def write_cameras(
    out: Path, format: str, photographs: Mapping[str, Path], estimated: EstimatedCameras
) -> None:
    """Write found cameras, and with COLMAP's formats the points that their matches determine.

    Args:
        out: File, or folder of COLMAP's; as :func:`check_target` permits.
        photographs: mapping str -> path. Photographs by the names of their cameras.

    Raises:
        InputError: If they cannot be written, or the format cannot hold them.
    """
    if format == "nerfstudio":
        nerfstudio.write(out, photographs, estimated)
        return
    model = build_sparse_model(photographs, estimated)
    if format == "llff":
        llff.write(out, photographs, model)
    else:
        colmap_writer.write(out, model, estimated, text=format == "colmap-text")
