"""RealEstate10K as it is published: a camera file a clip, and frames that lie at hand.

The files of https://google.github.io/realestate10k/ name a video and, a row a frame, the time and
the camera (:func:`slgaussian.datasets.re10k.read_cameras`). The frames are everybody's own to get.
Here they are photographs called after their time in microseconds, as ``45979267.jpg``, in a folder
called as the camera file is: ``train/000c3ab189999a83.txt`` and ``train/000c3ab189999a83/``, or
``cameras/...txt`` and ``frames/...``. Frames that are not there are left out.
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from slgaussian.datasets import re10k
from slgaussian.datasets.photographs import EXTENSIONS, open_rgb, stored_size
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Scene, View

CAMERAS, FRAMES = "cameras", "frames"
"""Folders beside each other that hold the camera files and, under the same names, the frames."""


def read(path: str | Path) -> Scene:
    """A clip as a scene called by its file; views are called by their photographs.

    Raises
    ------
    InputError
        If the camera file cannot be read, a camera is none, or fewer than two frames are there.
    """
    file = Path(path)
    _, times, rows = re10k.read_cameras(file)
    folder = frames_of(file)
    photographs, cameras = {}, {}
    for time, row in zip(times.tolist(), rows, strict=True):
        found = next((f for e in EXTENSIONS if (f := folder / f"{time}{e}").is_file()), None)
        size = None if found is None else stored_size(found)
        if found is None or size is None:
            continue
        photographs[found.name] = found
        try:
            cameras[found.name] = re10k.camera_of(row, *size)
        except InputError as bad:
            raise InputError(f"{file}: frame {time}: {bad}") from None
    if len(cameras) < 2:
        raise InputError(
            f"{file}: found {len(cameras)} of its {len(times)} frames in {folder}, expected two or "
            f"more, called by their times, as {times[0]}.jpg"
        )
    reader = _Reader(file, photographs, cameras)
    return Scene(file.stem, cameras, reader.read, sources=reader.sources)


def frames_of(file: Path) -> Path:
    """The folder of the frames of a camera file, whether it is there or not."""
    beside = file.with_suffix("")
    parts = list(file.parts)
    if not beside.is_dir() and CAMERAS in parts:
        parts[parts.index(CAMERAS)] = FRAMES
        return Path(*parts).with_suffix("")
    return beside


def is_camera_file(file: Path) -> bool:
    """Whether it begins with the address of a video, as these do."""
    try:
        with file.open("rb") as stream:
            start = stream.read(11).removeprefix(codecs.BOM_UTF8)
            return file.suffix == ".txt" and start.startswith((b"https://", b"http://"))
    except OSError:
        return False


@dataclass(frozen=True, eq=False)
class _Reader:
    file: Path
    photographs: Mapping[str, Path]
    cameras: Mapping[str, Camera]

    def read(self, name: str) -> View:
        """Open one frame."""
        return View(name, self.cameras[name], open_rgb(self.photographs[name]))

    def sources(self, name: str) -> list[Path]:
        """List the camera file and the photograph of a frame."""
        return [self.file, self.photographs[name]]
