"""Local cache of the Hugging Face hub, read without network access."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from slgaussian.errors import InputError
from slgaussian.extras import install_line


def is_hub_name(place: str | Path) -> bool:
    """Return whether a place has the form of a name on the hub, OWNER/NAME."""
    return str(place).count("/") == 1 and not str(place).startswith((".", "~", "/"))


def hub_download(place: str) -> Callable[..., str]:
    """Return huggingface_hub's download function; InputError if it is not installed."""
    try:
        from huggingface_hub import snapshot_download
    except ImportError as problem:
        raise InputError(
            f"{place}: is no folder here, and the hub needs the package huggingface_hub "
            f"({problem}); install it with {install_line('models')}"
        ) from None
    return snapshot_download


def local_place(place: str | Path) -> str:
    """Return the local path of a model or tokenizer.

    Args:
        place: File, folder, or name on the hub.

    Returns:
        str: For a name, the folder of its revision ``main`` in the hub's cache; any other place is
            returned unchanged.

    Raises:
        InputError: If the name is not in the cache.
    """
    name = str(place)
    if Path(name).exists() or not is_hub_name(name):
        return name
    snapshot_download = hub_download(name)
    try:
        return snapshot_download(name, local_files_only=True)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{name}: is no folder here, and not in the cache of the hub yet; it is downloaded "
            f"when it is first used, or now with `hf download {name}`"
        ) from error
