"""Estimate the cameras of photographs, and write them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.cli.text import aligned
from slgaussian import __version__
from slgaussian.cameras.found import FoundCameras
from slgaussian.datasets import nerfstudio, sparse, unposed
from slgaussian.errors import InputError
from slgaussian.formats import strict_json

MAKER = f"Cameras found from photographs by slgaussian {__version__}."


def report(estimate: FoundCameras) -> None:
    """Print how cameras were estimated, and warnings."""
    for warning in estimate.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(estimate.summary(), file=sys.stderr)


def estimate_cameras(photos: Sequence[str], out: str | None) -> FoundCameras:
    """Estimate the cameras of photographs, and write them where ``out`` says, if it does.

    To a file of nerfstudio's form, or to a folder as a COLMAP model if ``out`` ends in "/" or is
    one.

    Raises
    ------
    InputError
        If cameras cannot be found, or something else is at the place, which is seen first.
    """
    place = None if out is None else Path(out)
    model = place is not None and (str(out).endswith("/") or place.is_dir())
    if place is not None:
        _check_place(place, model)
    files = unposed.named(photos)
    estimate = unposed.find(files)
    if place is not None:
        if model:
            sparse.write_text(place, _model(estimate), MAKER)
        else:
            nerfstudio.write(place, files, estimate)
        _warn_of_turned(files)
    report(estimate)
    return estimate


def pairs_table(estimate: FoundCameras) -> str:
    """Return a row for each pair: matches, what agrees, angles and a verdict."""
    place = {name: number for number, name in enumerate([*estimate.cameras, *estimate.left_out])}
    rows: list[tuple[str, ...]] = [("pair", "matches", "agree", "angle", "off by", "verdict")]
    for pair in sorted(estimate.pairs, key=lambda pair: [place[name] for name in pair.views]):
        angles = (f"{a:.1f}" if np.isfinite(a) else "" for a in (pair.angle, pair.uncertainty))
        verdict = pair.verdict + (f": {pair.said}" if pair.said else "")
        views = " - ".join(pair.views)
        rows.append((views, str(pair.matches), str(pair.inliers), *angles, verdict))
    return aligned(rows, "<>>>><")


def _check_place(place: Path, model: bool) -> None:
    """Make the folder, and see that what is there was written by this command."""
    file = place / "cameras.txt" if model else place
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        ours = not file.exists() or _is_ours(file.read_bytes(), model)
    except OSError as bad:
        raise InputError(f"{place}: cannot be written ({bad.strerror}); choose another") from None
    if not ours:
        raise InputError(
            f"{file}: is there already, and not written by `slgaussian cameras`; choose another "
            "place, or remove it"
        )


def _is_ours(content: bytes, model: bool) -> bool:
    if model:
        return content.startswith(f"# {MAKER.split(__version__)[0]}".encode())
    try:
        parsed: Any = strict_json.parse(content)
    except ValueError:
        return False
    return isinstance(parsed, dict) and nerfstudio.OWN in parsed


def _model(estimate: FoundCameras) -> sparse.SparseModel:
    """A camera for each photograph, and the points that were matched."""
    cameras, images = {}, {}
    for number, (name, camera) in enumerate(estimate.cameras.items(), 1):
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        k1 = estimate.k1[name]
        lens = (k1, 0.0, 0.0, 0.0) if k1 else ()
        model = "OPENCV" if lens else "PINHOLE"
        size = camera.width, camera.height
        cameras[number] = sparse.SparseCamera(model, *size, (fx, fy, cx, cy, *lens))
        images[number] = sparse.SparseImage(name, number, camera.w2c)
    return sparse.SparseModel(cameras, images, estimate.points, np.zeros((0, 2), np.int64))


def _warn_of_turned(files: Mapping[str, Path]) -> None:
    turned = [name for name, file in files.items() if unposed.is_turned(file)]
    if turned:
        more = f" and {len(turned) - 1} more" if turned[1:] else ""
        print(
            f"warning: {turned[0]}{more} are stored turned, and the cameras are those of upright "
            "photographs: for programs that do not turn them, save upright copies",
            file=sys.stderr,
        )
