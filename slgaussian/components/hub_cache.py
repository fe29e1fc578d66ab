"""The Hugging Face hub's cache on this machine: what it holds, without asking the network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from slgaussian.errors import InputError
from slgaussian.extras import install_line


def is_hub_name(place: str | Path) -> bool:
    """Return whether a place can be a name on the hub, OWNER/NAME."""
    return str(place).count("/") == 1 and not str(place).startswith((".", "~", "/"))


def hub_download(place: str) -> Callable[..., str]:
    """Return the function that downloads a name; InputError if it is not installed."""
    try:
        from huggingface_hub import snapshot_download
    except ImportError as problem:
        raise InputError(
            f"{place}: is no folder here, and the hub needs the package huggingface_hub "
            f"({problem}); install it with {install_line('models')}"
        ) from None
    return snapshot_download


def local_place(place: str | Path) -> str:
    """Return the place of a model or tokenizer on this machine.

    Parameters
    ----------
    place : path or str
        File, folder, or name on the hub.

    Returns
    -------
    str
        The folder in the hub's cache of a name, which its revision ``main`` stands for; any other
        place as it is.

    Raises
    ------
    InputError
        If the cache does not hold the name.
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
