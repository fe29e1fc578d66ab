"""What `slgaussian cameras` does: find the cameras of photographs, say how surely, keep them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian import __version__
from slgaussian.cameras.found import FoundCameras
from slgaussian.datasets import nerfstudio, sparse, unposed
from slgaussian.errors import InputError
from slgaussian.formats import strict_json

FORMATS = ("nerfstudio", "colmap")
MAKER = f"Cameras found from photographs by slgaussian {__version__}."


def tell(found: FoundCameras) -> None:
    """Say how cameras were found, and what the user had better know of it."""
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(found.summary(), file=sys.stderr)


def keep(photos: Sequence[str], out: str | None, format: str | None) -> FoundCameras:
    """Find the cameras of photographs, and write them where ``out`` says, if it does.

    To a file of nerfstudio's form, or to a folder as a COLMAP model: of ``format``, or else to a
    folder if ``out`` ends in "/" or is one.

    Raises
    ------
    InputError
        If cameras cannot be found, or something else is at the place, which is seen first.
    """
    if format is not None and format not in FORMATS:
        raise InputError(f"--format: found {format!r}, expected {' or '.join(FORMATS)}")
    if format is not None and out is None:
        raise InputError("--format: says how to write, but not where; add -o")
    place = None if out is None else Path(out)
    if place is not None and out is not None:
        if format is None:
            format = "colmap" if out.endswith("/") or place.is_dir() else "nerfstudio"
        elif format == "nerfstudio" and (out.endswith("/") or place.is_dir()):
            place = place / nerfstudio.FILE
        _check_place(place, format)
    files = unposed.named(photos)
    found = unposed.find(files)
    if place is not None and format == "colmap":
        sparse.write_text(place, _model(found), MAKER)
    elif place is not None:
        nerfstudio.write(place, files, found)
    if place is not None:
        _warn_of_turned(files)
    return found


def tabled(found: FoundCameras) -> str:
    """A row for each pair: matches, what agrees, angles and a verdict."""
    place = {name: number for number, name in enumerate([*found.cameras, *found.left_out])}
    pairs = sorted(found.pairs, key=lambda pair: [place[name] for name in pair.views])
    rows = [
        (
            " - ".join(pair.views),
            str(pair.matches),
            str(pair.inliers),
            f"{pair.angle:.1f}" if np.isfinite(pair.angle) else "",
            f"{pair.uncertainty:.1f}" if np.isfinite(pair.uncertainty) else "",
            pair.verdict + (f": {pair.said}" if pair.said else ""),
        )
        for pair in pairs
    ]
    head = ("pair", "matches", "agree", "angle", "off by", "verdict")
    wide = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = []
    for row in (head, *rows):
        cells = [f"{cell:>{width}}" for cell, width in zip(row, wide, strict=True)]
        cells[0], cells[-1] = f"{row[0]:<{wide[0]}}", row[-1]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _check_place(place: Path, format: str) -> None:
    """Make the folder, and see that what is there was written by this command."""
    file = place / "cameras.txt" if format == "colmap" else place
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        ours = not file.exists() or _is_ours(file.read_bytes(), format)
    except OSError as bad:
        raise InputError(f"{place}: cannot be written ({bad.strerror}); choose another") from None
    if not ours:
        raise InputError(
            f"{file}: is there already, and not written by `slgaussian cameras`; choose another "
            "place, or remove it"
        )


def _is_ours(content: bytes, format: str) -> bool:
    if format == "colmap":
        return content.startswith(f"# {MAKER.split(__version__)[0]}".encode())
    try:
        parsed: Any = strict_json.parse(content)
    except ValueError:
        return False
    return isinstance(parsed, dict) and nerfstudio.OWN in parsed


def _model(found: FoundCameras) -> sparse.SparseModel:
    """A camera for each photograph, and the points that were matched."""
    cameras, images = {}, {}
    for number, (name, camera) in enumerate(found.cameras.items(), 1):
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        k1 = found.k1[name]
        lens = (k1, 0.0, 0.0, 0.0) if k1 else ()
        model = "OPENCV" if lens else "PINHOLE"
        size = camera.width, camera.height
        cameras[number] = sparse.SparseCamera(model, *size, (fx, fy, cx, cy, *lens))
        images[number] = sparse.SparseImage(name, number, camera.w2c)
    return sparse.SparseModel(cameras, images, found.points, np.zeros((0, 2), np.int64))


def _warn_of_turned(files: Mapping[str, Path]) -> None:
    turned = [name for name, file in files.items() if unposed.is_turned(file)]
    if turned:
        more = f" and {len(turned) - 1} more" if turned[1:] else ""
        print(
            f"warning: {turned[0]}{more} are stored turned, and the cameras are those of upright "
            "photographs: for programs that do not turn them, save upright copies",
            file=sys.stderr,
        )
