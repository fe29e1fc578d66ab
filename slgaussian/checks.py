"""Names of photographs, the files that belong to them, and their cameras.

Every :class:`slgaussian.scene.Scene` passes :func:`check_names` and :func:`check_cameras`,
whichever reader or program made it, and whatever belongs to a photograph (labels, masks, depth,
ids, predictions) is looked up by :func:`companion` or :func:`matching`. A name is a path with
slashes; backslashes of Windows count as slashes, and the suffix may differ.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.scene import Camera

SUFFIX = re.compile(r"\.[A-Za-z][A-Za-z0-9]*$")
"""Suffix of a file's name; in ``frame.0001`` there is none."""

MIN_FIELD_OF_VIEW, MAX_FIELD_OF_VIEW = 3.0, 175.0
"""Range of plausible fields of view, degrees."""


def natural_key(name: str) -> tuple:
    """Return a sort key by which numbers in names count as numbers: frame_2 before frame_10."""
    folders = [re.split(r"([0-9]+)", part) for part in name_parts(name)]
    return tuple([int(p) if k % 2 else p for k, p in enumerate(f)] for f in folders), name


def order_naturally(names: Iterable[str]) -> list[str]:
    """Return names in natural order if they are in the order of letters, as a shell lists them.

    Any other order is somebody's intention, such as time, and stays.
    """
    listed = list(names)
    return sorted(listed, key=natural_key) if listed == sorted(listed) else listed


@lru_cache(maxsize=2**16)
def name_parts(name: str, suffix: bool = False) -> tuple[str, ...]:
    """Split a name at slashes or backslashes, without "." and, unless ``suffix``, its suffix."""
    parts = [part for part in re.split(r"[\\/]+", name.strip(" \t")) if part not in ("", ".")]
    if parts and not suffix:
        parts[-1] = SUFFIX.sub("", parts[-1]) or parts[-1]
    return tuple(parts) or (name,)


def check_names(scene: str, names: Iterable[str]) -> None:
    """Raise InputError if two names are of one file, as ``a.jpg`` and ``./a.jpg`` are."""
    first: dict[tuple[str, ...], str] = {}
    for name in names:
        other = first.setdefault(name_parts(name, suffix=True), name)
        if other != name:
            raise InputError(
                f"scene {scene!r}: {other!r} and {name!r} name one photograph; remove one of them"
            )


def namesakes(name: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return the other names with the same file name, in any folder and with any suffix."""
    last = name_parts(name)[-1:]
    return tuple(other for other in names if other != name and name_parts(other)[-1:] == last)


def match_rank(entry: str, view: str) -> int:
    """Return how closely an entry of a file names a photograph; 0: not at all.

    4: the same path; 3: but for the suffix; 2: one is the end of the other, as ``/data/a/1.png``
    and ``a/1.jpg``; 1: the same file name in folders of other names.
    """
    if name_parts(entry, suffix=True) == name_parts(view, suffix=True):
        return 4
    a, b = name_parts(entry), name_parts(view)
    if a == b or name_parts(entry, suffix=True) == b or a == name_parts(view, suffix=True):
        return 3
    if a[-1:] != b[-1:]:
        return 0
    count = min(len(a), len(b))
    return 2 if a[-count:] == b[-count:] else 1


def matching(place: str, view: str, entries: Collection[str], others: Sequence[str]) -> str | None:
    """Return the entry of a file that names a photograph; None if none does.

    An entry that names another photograph more closely belongs to that one.

    Args:
        place: Name of the file, for messages.
        view: Name of the photograph.
        entries: Names in the file.
        others: Names of the other photographs of the scene; only :func:`namesakes` matter.

    Raises:
        InputError: If the entry fits another photograph as well, or two entries fit this one.
    """
    ranks = {entry: match_rank(entry, view) for entry in entries}
    others = namesakes(view, others)
    rivals = {entry: {o: match_rank(entry, o) for o in others} for entry in ranks if ranks[entry]}
    ours = {e: r for e, r in ranks.items() if r and r >= max(rivals[e].values(), default=0)}
    closest = [entry for entry, rank in ours.items() if rank == max(ours.values())]
    if len(closest) > 1:
        raise InputError(
            f"{place}: {closest[0]!r} and {closest[1]!r} both fit the photograph {view!r}; remove "
            "one of them"
        )
    for entry in closest:
        for other, rank in rivals[entry].items():
            if rank == ours[entry]:
                raise InputError(
                    f"{place}: {entry!r} fits two photographs, {view!r} and {other!r}; name it by "
                    "its path, with the folder of its photograph"
                )
    return closest[0] if closest else None


def companion(
    folder: Path, view: str, suffixes: Sequence[str], others: Sequence[str] = (), prefix: str = ""
) -> Path | None:
    """Return the file in a folder that belongs to a photograph; None if there is none.

    For ``left/0001.jpg`` and the suffix ``.png`` it is ``left/0001.png`` or ``left/0001.jpg.png``,
    or else ``0001.png`` or ``0001.jpg.png`` if no other photograph has that file name.

    Args:
        folder: Folder of the companions.
        view: Name of the photograph.
        suffixes: Ends of their names, with the dot; "" for a folder.
        others: Names of the other photographs of the scene; only :func:`namesakes` matter.
        prefix: Start of their names, before the file name of the photograph.

    Raises:
        InputError: If the file fits another photograph as well, or two files fit this one.
    """
    rivals = namesakes(view, others)
    wholes = [name_parts(view), name_parts(view, suffix=True)]
    for start in range(len(wholes[0])):
        paths = {
            folder.joinpath(*parts[start:-1], f"{prefix}{parts[-1]}{suffix}"): parts
            for parts in wholes
            for suffix in suffixes
        }
        files = [path for path in paths if _is_there(path, folder="" in suffixes)]
        if len(files) > 1:
            raise InputError(
                f"{files[0]}: {files[1].name} is there too, for the photograph {view!r}; remove "
                "one of them"
            )
        for file in files:
            tail = paths[file][start:]
            for other in rivals:
                parts = name_parts(other, suffix=paths[file] is wholes[1])
                # The whole path of one photograph may be the end of that of another.
                if parts == tail if start == 0 else parts[-len(tail) :] == tail:
                    raise InputError(
                        f"{file}: fits two photographs, {view!r} and {other!r}; put it into a "
                        f"folder as that of its photograph, {'/'.join(wholes[0][:-1]) or '.'}"
                    )
            return file
    return None


def _is_there(path: Path, folder: bool) -> bool:
    try:
        return path.is_dir() if folder else path.is_file()
    except (OSError, ValueError):  # invalid names, which camera files may contain
        return False


def check_cameras(cameras: Mapping[str, Camera], find_place: Callable[[str], object]) -> None:
    """Check the intrinsics of cameras by view name, as :func:`check_intrinsics`.

    ``find_place`` returns what has a camera, for the message.
    """
    for name, camera in cameras.items():
        try:
            check_intrinsics(camera)
        except InputError as bad:
            raise InputError(f"{find_place(name)}: {name!r}: {bad}") from None


def check_intrinsics(camera: Camera, fractions: bool = False) -> None:
    """Check that the intrinsics of a camera are plausible.

    The field of view across each side is at most :data:`MAX_FIELD_OF_VIEW` degrees, and across the
    longer side, with either focal length, at least :data:`MIN_FIELD_OF_VIEW`. The principal point
    is at most a photograph's size away from the photograph, and not in its first pixel, where
    fractions lie.

    Args:
        fractions: Whether the file has fractions of width and height, as in RealEstate10K, not
            pixels.

    Raises:
        InputError: If they are not; the message gives the number as in the file.
    """
    width, height = camera.width, camera.height
    unit = "fractions of width and height" if fractions else "pixels"
    for axis, focal, side in (("x", camera.K[0, 0], width), ("y", camera.K[1, 1], height)):
        sides = (side, max(width, height))
        view, longest_view = (math.degrees(2 * math.atan2(s / 2, focal)) for s in sides)
        if view > MAX_FIELD_OF_VIEW or longest_view < MIN_FIELD_OF_VIEW:
            raise InputError(
                f"focal length {axis} is {focal / side if fractions else focal:.6g}, for "
                f"{width}x{height} pixels a field of view of {view:.3g} degrees, expected "
                f"{MIN_FIELD_OF_VIEW:g} to {MAX_FIELD_OF_VIEW:g}; give it in {unit}"
            )
    x, y = camera.K[:2, 2]
    is_near = -width <= x <= 2 * width and -height <= y <= 2 * height
    is_fraction = not fractions and 0 <= x < 1 and 0 <= y < 1 and min(width, height) > 2
    if not is_near or is_fraction:
        x, y = (x / width, y / height) if fractions else (x, y)
        raise InputError(
            f"principal point is ({x:.6g}, {y:.6g}), far from the middle of {width}x{height} "
            f"pixels; give it in {unit}"
        )
