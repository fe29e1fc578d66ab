"""Atomic writing of pictures and videos in the format of the file name."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.io import atomic_path, write_file

PICTURES = (".png", ".jpg", ".jpeg")
FILMS = (".mp4",)

FRAME_RATE = 15
"""Frames per second."""

VP9 = "vp09"
"""Codec of .mp4 files: browsers, VLC and mpv play it, and OpenCV includes its encoder."""


def check_picture(path: Path, kinds: Sequence[str] = PICTURES) -> None:
    """Check, before the work, that a file of one of these suffixes can be written to ``path``.

    Raises:
        InputError: If the name has another suffix, or no file can be created.
    """
    if path.suffix.lower() not in kinds:
        kind = {PICTURES: "picture", FILMS: "film"}.get(tuple(kinds), "file")
        raise InputError(
            f"{path}: found {path.suffix or 'no suffix'!r}, expected the name of a {kind} to end "
            f"in {' or '.join(kinds)}"
        )
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        reason = "it is a folder" if path.is_dir() else "its folder is missing or read-only"
        raise InputError(f"{path}: cannot be written ({reason}); name a file in a writable folder")


def write_picture(path: Path, *images: np.ndarray) -> None:
    """Write a column of images uint8 [H, W, 3] as a PNG or JPEG; InputError if it fails."""
    width = max(image.shape[1] for image in images)
    sheet = np.concatenate(
        [
            np.pad(image, ((0, 0), (0, width - image.shape[1]), (0, 0)), constant_values=255)
            for image in images
        ]
    )
    out = io.BytesIO()
    try:
        if path.suffix.lower() == ".png":
            Image.fromarray(sheet).save(out, "PNG", compress_level=6)
        else:
            Image.fromarray(sheet).save(out, "JPEG", quality=92, subsampling=0)
    except (OSError, ValueError) as error:  # a JPEG has at most 65,500 rows
        raise InputError(f"{path}: {width}x{len(sheet)} pixels: {error}") from None
    write_file(path, out.getvalue())


def write_film(path: Path, frames: Iterable[np.ndarray]) -> None:
    """Write images uint8 [H, W, 3] of one size as an MP4; InputError if it fails."""
    import cv2

    with atomic_path(path) as temporary:
        # OpenCV chooses the format by the suffix.
        draft, written = f"{temporary}{path.suffix}", 0
        writer = cv2.VideoWriter()
        try:
            for frame in frames:
                if not written:
                    codec = cv2.VideoWriter_fourcc(*VP9)
                    writer.open(draft, cv2.CAP_FFMPEG, codec, FRAME_RATE, frame.shape[1::-1])
                writer.write(np.ascontiguousarray(frame[..., ::-1]))
                written += 1
            writer.release()
            # OpenCV raises no error on failure, so the file is read back.
            if cv2.VideoCapture(draft).get(cv2.CAP_PROP_FRAME_COUNT) != written:
                raise InputError(
                    f"{path}: cannot be written by the installed OpenCV, or the disk is full; free "
                    "disk space, or reinstall opencv-contrib-python-headless"
                )
            os.replace(draft, temporary)
        finally:
            writer.release()
            Path(draft).unlink(missing_ok=True)
