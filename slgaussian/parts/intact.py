"""Whether the weights of a model are whole: of the size, the content and the numbers they must be.

A download that was cut short leaves a file that is too short, or zeros where the rest belongs; a
bad disk or an early halt of the program that wrote it leaves others.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from slgaussian.errors import InputError

SHA256 = re.compile("[0-9a-f]{64}")

AGAIN = "get it again"

LONGEST = 100_000_000
"""Bytes of the longest header that the safetensors format allows."""


def check_whole(file: Path) -> str:
    """The SHA-256 of a file of a model, hexadecimal, if nothing of the file is missing.

    The length of a ``.safetensors`` file is told by its header. The hub's cache keeps a large file
    under the SHA-256 that the hub knows it by.

    Raises
    ------
    InputError
        If the file cannot be read, is shorter or longer than its header says, or is not the one
        that the hub's cache took it for.
    """
    try:
        if file.suffix == ".safetensors":
            _check_length(file)
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); {AGAIN}") from error
    stored = file.resolve()
    if SHA256.fullmatch(stored.name) and stored.name != digest:
        raise InputError(
            f"{file}: is damaged: its SHA-256 begins with {digest[:8]}, and of the file on the hub "
            f"with {stored.name[:8]}; delete {stored} and {AGAIN}"
        )
    return digest


def check_numbers(network: Any, source: str) -> None:
    """InputError if a weight of a network of PyTorch is NaN or infinite."""
    for name, tensor in network.named_parameters():
        if not tensor.isfinite().all():
            raise InputError(f"model {source}: {name} holds NaN or infinity; {AGAIN}")


def zero_matrices(network: Any) -> tuple[list[str], float]:
    """The matrices of a network that are zero all over, and their share of all its weights.

    One or the other may be so by right; where a download stopped, many are.
    """
    sizes = {name: tensor.numel() for name, tensor in network.named_parameters()}
    zero = [
        name
        for name, tensor in network.named_parameters()
        if tensor.ndim > 1 and tensor.numel() > 1 and not tensor.any()
    ]
    return zero, sum(sizes[name] for name in zero) / max(1, sum(sizes.values()))


def _check_length(file: Path) -> None:
    size = file.stat().st_size
    with file.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        if not 0 < length <= LONGEST:
            raise InputError(f"{file}: is damaged, or no safetensors file; {AGAIN}")
        header = stream.read(length)
    if size < 8 + length:
        raise InputError(f"{file}: is cut short within its header, at {size:,} bytes; {AGAIN}")
    try:
        told = json.loads(header)
        ends = [t["data_offsets"][1] for name, t in told.items() if name != "__metadata__"]
        whole = 8 + length + max(ends, default=0)
    except (ValueError, TypeError, LookupError, AttributeError):
        raise InputError(f"{file}: is damaged, or no safetensors file; {AGAIN}") from None
    if size != whole:
        what = "is cut short" if size < whole else "is too long"
        raise InputError(f"{file}: {what}: found {size:,} bytes, expected {whole:,}; {AGAIN}")
