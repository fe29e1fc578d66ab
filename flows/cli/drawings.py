"""Pictures and films in the format that a file's name says: complete, or not at all."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.io import write_file

PICTURES = (".png", ".jpg", ".jpeg")
FILMS = (".mp4", ".gif")

RATE = 15
"""Frames a second."""

VP9 = "vp09"
"""What a .mp4 holds: browsers, VLC and mpv play it, and OpenCV brings its encoder along."""

Draw = Callable[[np.ndarray], None]


def check_drawing(path: Path, film: bool) -> None:
    """See that a picture, or a film, can be written to ``path``; call it before the work.

    Raises
    ------
    InputError
        If the name has no suffix of a format that is written, or no file can be made there.
    """
    kinds, what = (FILMS, "film") if film else (PICTURES, "picture")
    if path.suffix.lower() not in kinds:
        hint = ""
        if path.suffix.lower() in FILMS:
            hint = "; a film is made of a turn, as in --orbit 60"
        elif path.suffix.lower() in PICTURES:
            hint = "; leave out --orbit for one picture"
        raise InputError(
            f"{path}: found {path.suffix or 'no suffix'!r}, expected the name of a {what} to end "
            f"in {' or '.join(kinds)}{hint}"
        )
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        why = "it is a folder" if path.is_dir() else "its folder is not there or not yours to write"
        raise InputError(f"{path}: cannot be written ({why}); name a file in a folder that exists")


@contextmanager
def drawing(path: Path | None, film: bool) -> Iterator[Draw]:
    """Takes images uint8 [H, W, 3] one by one, and writes them to ``path`` once all were drawn.

    A picture has them below each other; a film shows them one after the other, and needs all of one
    size. Without a path they are dropped.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    if path is None:
        yield lambda image: None
    elif not film:
        rows: list[np.ndarray] = []
        yield rows.append
        write_picture(path, below_each_other(rows))
    elif path.suffix.lower() == ".gif":
        frames: list[Image.Image] = []
        # A palette a frame, so that at once only a byte a pixel is kept.
        yield lambda image: frames.append(Image.fromarray(image).quantize(256))
        write_file(path, _gif(frames))
    else:
        with _mp4(path) as draw:
            yield draw


def write_picture(path: Path, image: np.ndarray) -> None:
    """Write an image uint8 [H, W, 3] as what the file's name says; InputError if it cannot be."""
    kind = "PNG" if path.suffix.lower() == ".png" else "JPEG"
    how = {"compress_level": 6} if kind == "PNG" else {"quality": 92, "subsampling": 0}
    out = io.BytesIO()
    try:
        Image.fromarray(image).save(out, kind, **how)
    except (OSError, ValueError) as error:  # a JPEG has at most 65,500 rows
        raise InputError(f"{path}: {image.shape[1]}x{image.shape[0]} pixels: {error}") from None
    write_file(path, out.getvalue())


def write_ids(path: Path, ids: np.ndarray) -> None:
    """Write ids int32 [H, W] as :func:`slgaussian.masks.precomputed.encode_ids` does."""
    from slgaussian.masks.precomputed import encode_ids

    write_file(path, encode_ids(ids)[1])


def below_each_other(images: Sequence[np.ndarray]) -> np.ndarray:
    """Images uint8 [H, W, 3] in a column, white beside the narrower ones."""
    width = max(image.shape[1] for image in images)
    rows = [((0, 0), (0, width - image.shape[1]), (0, 0)) for image in images]
    return np.concatenate(
        [np.pad(i, row, constant_values=255) for i, row in zip(images, rows, strict=True)]
    )


def _gif(frames: Sequence[Image.Image]) -> bytes:
    out = io.BytesIO()
    first, *others = frames
    first.save(out, "GIF", save_all=True, append_images=others, duration=round(1000 / RATE), loop=0)
    return out.getvalue()


@contextmanager
def _mp4(path: Path) -> Iterator[Draw]:
    import cv2

    from slgaussian.io import atomic_path

    with atomic_path(path) as temporary:
        # OpenCV knows a format by the suffix.
        draft = f"{temporary}{path.suffix}"
        writer, written = cv2.VideoWriter(), 0

        def draw(image: np.ndarray) -> None:
            nonlocal written
            if not written:
                size = image.shape[1::-1]
                writer.open(draft, cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*VP9), RATE, size)
            writer.write(np.ascontiguousarray(image[..., ::-1]))
            written += 1

        try:
            yield draw
            writer.release()
            # OpenCV does not say what went wrong, so the file is asked.
            there = cv2.VideoCapture(draft).get(cv2.CAP_PROP_FRAME_COUNT)
            if there != written:
                raise InputError(
                    f"{path}: cannot be written as .mp4 by the OpenCV that is installed, or the "
                    f"disk is full; try {path.with_suffix('.gif').name}"
                )
            os.replace(draft, temporary)
        finally:
            writer.release()
            Path(draft).unlink(missing_ok=True)
