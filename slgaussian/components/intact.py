"""Check of a component's files by loading the component."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slgaussian.components.component import Component
from slgaussian.components.pretrained import (
    find_model,
    find_tokenizer,
    model_digest,
    tokenizer_digest,
)
from slgaussian.components.registry import find_config
from slgaussian.errors import InputError


def check_component(kind: str, name: str, values: Mapping[str, Any]) -> str:
    """Check the files of a component without downloading anything.

    Models are loaded, which checks their configuration and the names and shapes of tensors; their
    weights must be finite.

    Args:
        kind, name: Arguments of :func:`slgaussian.components.registry.find_config`.
        values: Fields of the component.

    Returns:
        str: A sentence about the files; empty for a component without files.

    Raises:
        InputError: If a file is missing, damaged, or not what the component needs.
    """
    files = find_config(kind, name).files()
    places = {key: values[key] for key in files if values.get(key) is not None}
    for key, place in places.items():
        if files[key].digest is model_digest:
            find_model(place, download=False)
        elif files[key].digest is tokenizer_digest:
            find_tokenizer(place, download=False)
    part = Component.of(kind, name, values).load()
    label = ", ".join(f"{key} {place}" for key, place in places.items())
    if (network := getattr(part, "network", None)) is not None:
        for tensor_name, tensor in network.named_parameters():
            if not tensor.isfinite().all():
                raise InputError(f"{label}: {tensor_name} holds NaN or infinity; get it again")
    return f"{label}: can be loaded" if label else ""
