"""One reader a format, each returning a Scene in the project's one camera convention."""

import inspect
from typing import Any

from slgaussian.errors import InputError
from slgaussian.registry import resolve
from slgaussian.scene import Scene

READERS = {
    "nerfstudio": "slgaussian.datasets.nerfstudio:read",
    "re10k": "slgaussian.datasets.re10k:read",
    "stereo": "slgaussian.datasets.stereo:read",
    "procedural": "slgaussian.datasets.procedural:read",
}


def load(format: str, *args: Any, **settings: Any) -> Scene:
    """Read a scene with the reader of that format; arguments are the reader's own.

    ``load("nerfstudio", "photos/")``, ``load("re10k", "re10k/test", "5aca87f95a9412c6")``,
    ``load("procedural", seed=3)``.

    Raises
    ------
    InputError
        If the format is unknown, it does not take these arguments or the data cannot be used.
    """
    read = resolve("data format", READERS, format)
    try:
        inspect.signature(read).bind(*args, **settings)
    except TypeError as error:
        takes = ", ".join(inspect.signature(read).parameters) or "nothing"
        raise InputError(f"data format {format!r}: {error}; it takes {takes}") from None
    return read(*args, **settings)
