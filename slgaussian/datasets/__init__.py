"""One reader a format, each returning a Scene in the project's one camera convention."""

from typing import Any

from slgaussian.registry import resolve
from slgaussian.scene import Scene

READERS = {
    "nerfstudio": "slgaussian.datasets.nerfstudio:read",
    "stereo": "slgaussian.datasets.stereo:read",
    "procedural": "slgaussian.datasets.procedural:read",
}


def load(format: str, *args: Any, **settings: Any) -> Scene:
    """Read a scene with the reader of that format; arguments are the reader's own.

    ``load("nerfstudio", "photos/")``, ``load("stereo")``, ``load("procedural", seed=3)``.

    Raises
    ------
    InputError
        If the format is unknown or the data cannot be used.
    """
    return resolve("data format", READERS, format)(*args, **settings)
