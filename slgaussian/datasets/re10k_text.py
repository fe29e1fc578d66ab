"""RealEstate10K as published: one camera file per clip, with frames extracted by the user.

The files of https://google.github.io/realestate10k/ have the address of a video in their first line
and, one line per frame, the time and the 18 numbers of a camera
(:mod:`slgaussian.datasets.re10k`). The user extracts the frames: photographs named by their time in
microseconds, such as ``45979267.jpg``, in a folder named like the camera file:
``train/000c3ab189999a83.txt`` and ``train/000c3ab189999a83/``, or ``cameras/...txt`` and
``frames/...``. Missing frames are left out.
"""

from __future__ import annotations

import codecs
import math
from pathlib import Path

import numpy as np

from slgaussian.datasets import re10k
from slgaussian.datasets.photographs import EXTENSIONS, scene_of, stored_size
from slgaussian.errors import InputError
from slgaussian.formats.text import read_lines
from slgaussian.scene import Scene

CAMERAS, FRAMES = "cameras", "frames"
"""Sibling folders of the camera files and, under the same names, of the frames."""


def read(path: str | Path) -> Scene:
    """Read a clip as a scene named by its file; views are named by their photographs.

    Raises:
        InputError: If the camera file cannot be read, a camera is invalid, or fewer than two frames
            exist.
    """
    file = Path(path)
    _, times, rows = read_cameras(file)
    folder = frames_of(file)
    photographs, cameras = {}, {}
    for time, row in zip(times.tolist(), rows, strict=True):
        photograph = next((f for e in EXTENSIONS if (f := folder / f"{time}{e}").is_file()), None)
        size = None if photograph is None else stored_size(photograph)
        if photograph is None or size is None:
            continue
        photographs[photograph.name] = photograph
        try:
            cameras[photograph.name] = re10k.camera_of(row, *size)
        except InputError as bad:
            raise InputError(f"{file}: frame {time}: {bad}") from None
    if len(cameras) < 2:
        raise InputError(
            f"{file}: found {len(cameras)} of its {len(times)} frames in {folder}, expected two or "
            f"more, called by their times, as {times[0]}.jpg"
        )
    return scene_of(file.stem, cameras, photographs, file, [file])


def read_cameras(file: str | Path) -> tuple[str, np.ndarray, np.ndarray]:
    """Read a raw camera file: the clip's address, timestamps int64 [N], rows float32 [N, 18].

    A file may lack the address, which is then returned as "".

    Raises:
        InputError: If the file cannot be read, or a line is not a camera; the message names the
            line.
    """
    try:
        lines = read_lines(file)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: cannot be read ({error})") from None
    has_address = len(lines[0].split()) != 1 + re10k.ROW
    address = lines[0].strip() if has_address else ""
    times, rows = [], []
    for number, line in enumerate(lines, 1):
        if number == 1 and has_address:
            continue
        words = line.split()
        if not words:
            continue
        try:
            values = [float(word) for word in words[1:]]
            times.append(int(words[0]))
        except ValueError:
            values = []
        times_fit = not times or abs(times[-1]) < 2**63
        if len(values) != re10k.ROW or not times_fit or not all(map(math.isfinite, values)):
            expected = f"a time and {re10k.ROW} numbers"
            raise InputError(f"{file}, line {number}: found {line[:60]!r}, expected {expected}")
        rows.append(values)
    if not rows:
        raise InputError(f"{file}: holds no camera; expected an address, then a line a frame")
    return address, np.array(times, np.int64), np.array(rows, np.float32)


def frames_of(file: Path) -> Path:
    """Return the folder of the frames of a camera file, which may be missing."""
    beside = file.with_suffix("")
    parts = list(file.parts)
    if not beside.is_dir() and CAMERAS in parts:
        parts[parts.index(CAMERAS)] = FRAMES
        return Path(*parts).with_suffix("")
    return beside


def is_camera_file(file: Path) -> bool:
    """Tell whether a file begins with the address of a video, as camera files do."""
    try:
        with file.open("rb") as stream:
            start = stream.read(11).removeprefix(codecs.BOM_UTF8)
            return file.suffix == ".txt" and start.startswith((b"https://", b"http://"))
    except OSError:
        return False
