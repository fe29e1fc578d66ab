"""Names of photographs: their order, their uniqueness, and the files that belong to them.

Every :class:`slgaussian.scene.Scene` passes :func:`check_names`, whichever reader or program made
it, and whatever belongs to a photograph (labels, masks, depth, ids, predictions) is looked up by
:func:`companion` or :func:`matching`. A name is a path with slashes; backslashes of Windows count
as slashes, and the suffix may differ.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from functools import lru_cache
from pathlib import Path

from slgaussian.errors import InputError

SUFFIX = re.compile(r"\.[A-Za-z][A-Za-z0-9]*$")
"""Suffix of a file's name; in ``frame.0001`` there is none."""


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
