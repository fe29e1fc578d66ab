"""Checks of a component's files, by the hub's digests or by loading and testing the component."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.components.component import Component
from slgaussian.components.hub_cache import local_place
from slgaussian.components.known_answers import KNOWN
from slgaussian.components.pretrained import find_model, model_digest, tokenizer_digest
from slgaussian.components.registry import find_config
from slgaussian.errors import InputError

SHA256 = re.compile("[0-9a-f]{64}")
AGAIN = "get it again"


def check_component(kind: str, name: str, values: Mapping[str, Any]) -> str:
    """Check the files of a component without downloading anything.

    Files in the hub's cache are compared with the hub's digests. Models are loaded, which checks
    their configuration and the names and shapes of tensors. Their weights and their outputs for a
    grey image must be finite, and they are tested on pictures with known answers
    (:mod:`slgaussian.components.known_answers`).

    Args:
        kind, name: Arguments of :func:`slgaussian.components.registry.find_config`.
        values: Fields of the component.

    Returns:
        str: A sentence about the files; empty for a component without files.

    Raises:
        InputError: If a file is missing, damaged, or not what the component needs.
    """
    config, places, verified = find_config(kind, name), dict(values), list[bool]()
    for key, file in config.files().items():
        if places.get(key) is not None and file.digest in (model_digest, tokenizer_digest):
            places[key] = local_place(places[key])
            if file.digest is model_digest:
                weights = [f for f in find_model(places[key]).files if f.suffix != ".json"]
                verified += map(is_of_hub, weights)
    label = ", ".join(f"{key} {places[key]}" for key in config.files() if places.get(key))
    part = Component.of(kind, name, places).load()
    check_numbers(part, label)
    if not label:
        return ""
    known = verified and all(verified)
    facts = ["is what the hub has, by its SHA-256" if known else "can be loaded and used"]
    if kind in KNOWN and {"model", "checkpoint"} & config.files().keys():
        facts.append(KNOWN[kind](part))
    return f"{label}: {', '.join(facts)}"


def is_of_hub(file: Path) -> bool:
    """Return whether a file is in the hub's cache and its content has the cached SHA-256.

    Raises:
        InputError: If its content has another SHA-256, or it cannot be read.
    """
    stored = file.resolve()
    if not SHA256.fullmatch(stored.name):
        return False
    try:
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); {AGAIN}") from error
    if stored.name != digest:
        raise InputError(
            f"{file}: is damaged: its SHA-256 begins with {digest[:8]}, and of the file on the hub "
            f"with {stored.name[:8]}; delete {stored} and {AGAIN}"
        )
    return True


def check_numbers(part: Any, source: str) -> None:
    """Raise InputError if weights or outputs of a loaded component are NaN or infinite.

    Outputs are those of encoders and proposers for one grey image.
    """
    network = getattr(part, "network", None)
    if network is None:
        return
    for name, tensor in network.named_parameters():
        if not tensor.isfinite().all():
            raise InputError(f"{source}: {name} holds NaN or infinity; {AGAIN}")
    image, results = np.full((64, 64, 3), 128, np.uint8), []
    if hasattr(part, "encode_regions"):
        results = [part.encode_regions(image, np.ones((1, 64, 64), bool))]
        results.append(part.encode_text(["object"]))
    elif hasattr(part, "encode"):
        import torch

        with torch.inference_mode():
            points = np.array([[32.0, 32.0]])
            results = [tensor.cpu().numpy() for tensor in part.encode(image).segment(points)]
    if not all(np.isfinite(result).all() for result in results):
        raise InputError(f"{source}: makes NaN or infinity of a grey image; {AGAIN}")
