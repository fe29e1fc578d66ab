"""Checks of a component's files, by the hub's digests and by loading the component."""

from __future__ import annotations

import re
from pathlib import Path

from slgaussian.components.config import ComponentConfig
from slgaussian.components.pretrained import (
    find_model,
    find_tokenizer,
    model_digest,
    tokenizer_digest,
)
from slgaussian.errors import InputError
from slgaussian.io import file_sha256

SHA256 = re.compile("[0-9a-f]{64}")
REPAIR = "get it again"


def check_component(component: ComponentConfig) -> str:
    """Check the files of a component without downloading anything.

    Weights in the hub's cache are compared with the hub's digests. Models are loaded, which checks
    their configuration and the names and shapes of tensors; their weights must be finite.

    Returns:
        str: A sentence about the files; empty for a component without files.

    Raises:
        InputError: If a file is missing, damaged, or not what the component needs.
    """
    verified, places = list[bool](), list[str]()
    for key, file in component.files().items():
        if (place := getattr(component, key)) is None:
            continue
        places.append(f"{key} {place}")
        if file.digest is model_digest:
            weights = find_model(place, download=False).files
            verified += [is_of_hub(each) for each in weights if each.suffix != ".json"]
        elif file.digest is tokenizer_digest:
            find_tokenizer(place, download=False)
    network, label = getattr(component.pin().load(), "network", None), ", ".join(places)
    for name, tensor in () if network is None else network.named_parameters():
        if not tensor.isfinite().all():
            raise InputError(f"{label}: {name} holds NaN or infinity; {REPAIR}")
    of_hub = verified and all(verified)
    verdict = "is what the hub has, by its SHA-256" if of_hub else "can be loaded"
    return f"{label}: {verdict}" if label else ""


def is_of_hub(file: Path) -> bool:
    """Return whether a file is in the hub's cache and its content has the cached SHA-256.

    Raises:
        InputError: If its content has another SHA-256, or it cannot be read.
    """
    stored = file.resolve()
    if not SHA256.fullmatch(stored.name):
        return False
    try:
        digest = file_sha256(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); {REPAIR}") from error
    if stored.name != digest:
        raise InputError(
            f"{file}: is damaged: its SHA-256 begins with {digest[:8]}, and of the file on the hub "
            f"with {stored.name[:8]}; delete {stored} and {REPAIR}"
        )
    return True
