"""The class masks of 3D-OVS: ``<frame>/<class>.png`` for every class of ``classes.txt``.

A line of ``classes.txt`` is a class and its query text. 3D-OVS uses the folder's number as an index
into the sorted photographs. In the published scenes it equals the photograph's name; this reader
uses the name.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.images import read_mask
from slgaussian.formats.resampling import Window
from slgaussian.formats.text import read_lines

FILE = "classes.txt"
INSIDE = 255
"""Grey level of the class; all other levels, blurred edges included, are background in 3D-OVS."""


def are_in(folder: str | Path) -> bool:
    """Tell whether a folder of labels contains class masks."""
    return (Path(folder) / FILE).is_file()


def classes(folder: str | Path) -> tuple[str, ...]:
    """Read the classes, sorted; InputError if there are none, or duplicates."""
    file = Path(folder) / FILE
    try:
        lines = read_lines(file)
    except (OSError, UnicodeDecodeError) as bad:
        raise InputError(f"{file}: cannot be read ({bad})") from None
    names = sorted(name for line in lines if (name := line.strip(" \t")))
    if not names or len(set(names)) < len(names):
        raise InputError(f"{file}: found {names}, expected different classes, one a line")
    # Reject class names that leave the folder or are longer than a file name may be.
    if unfit := [n for n in names if "/" in n or "\0" in n or len(f"{n}.png".encode()) > 255]:
        raise InputError(f"{file}: the class {unfit[0]!r:.80} can be no file's name; rename it")
    return tuple(names)


def frames(folder: str | Path) -> list[str]:
    """List the frames with masks, sorted."""
    return sorted(path.name for path in Path(folder).iterdir() if path.is_dir())


def files(folder: str | Path, view_name: str) -> list[Path]:
    """Return the files from which the masks of a frame are read."""
    frame_folder = Path(folder) / Path(view_name).stem
    return [Path(folder) / FILE, *(frame_folder / f"{name}.png" for name in classes(folder))]


def read(
    folder: str | Path, view_name: str, width: int, height: int, window: Window | None = None
) -> dict[str, np.ndarray]:
    """Read the masks of a view, bool [height, width] by class.

    They are resampled to its size and to the part ``window`` of the photograph, see
    :func:`slgaussian.benchmark.annotations.read_labels`. A class that is cropped away, or not in
    the frame, has an empty mask.

    Raises:
        InputError: If a file is missing or damaged, contains only grey levels other than 0 and 255,
            or has another aspect ratio than the photograph.
    """
    names = classes(folder)
    masks = {}
    for name, file in zip(names, files(folder, view_name)[1:], strict=True):
        if not file.is_file():
            raise InputError(
                f"{file}: no such mask; every labelled frame needs one for each class of {FILE}, "
                "black where it does not show it"
            )
        mask = read_mask(file, INSIDE)
        full_h, full_w = mask.shape
        part = window or Window.covering(full_w, full_h, width, height)
        part.check_shape(file, full_w, full_h)
        masks[name] = part.mask(mask, height, width)
    return masks
