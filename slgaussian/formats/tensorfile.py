"""Reading of untrusted ``torch.save`` files without executing code."""

from __future__ import annotations

import io
import pickle
import pickletools
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

TORCHSCRIPT_REFUSAL = (
    "it is a TorchScript archive, which holds code; if you trust it, save its tensors alone: "
    "torch.save(torch.jit.load(FILE, map_location='cpu').state_dict(), NEW_FILE)"
)
"""Message for files of ``torch.jit.save``, such as OpenAI's CLIP."""

MAX_GLOBAL_LENGTH = 1000
"""Largest number of characters of a global with its module; PyTorch's own have at most 51."""


class CodeError(ValueError):
    """A file requires code to be run; the message is the name of the global."""


def _check_globals(pickled: bytes) -> None:
    """Raise ValueError for a damaged pickle, or a global over :data:`MAX_GLOBAL_LENGTH`.

    PyTorch refuses both, but searches its message in quadratic time: over a minute for a million
    letters.
    """
    try:
        names = [str(name) for op, name, _ in pickletools.genops(pickled) if op.name == "GLOBAL"]
    except Exception:  # a damaged pickle raises almost anything
        raise ValueError("it cannot be unpickled") from None
    if any(len(name) > MAX_GLOBAL_LENGTH for name in names):
        raise ValueError("it cannot be unpickled")


def load(source: Path | bytes, mapped: bool = False) -> Any:
    """Load a file on the CPU with PyTorch's restricted unpickler.

    Args:
        mapped: Memory-map the file if possible, so that only the tensors in use are read.

    Raises:
        CodeError: If it contains more than plain data and tensors.
        OSError: If the file cannot be read.
        ValueError: If it is damaged, a TorchScript archive, or compressed: ``torch.save`` never
            compresses, and a thousandfold expansion could fill the memory.
    """
    stream = io.BytesIO(source) if isinstance(source, bytes) else source
    try:
        if zipped := zipfile.is_zipfile(stream):
            with zipfile.ZipFile(stream) as archive:
                members = archive.infolist()
                if any("/code/" in member.filename for member in members):
                    raise ValueError(TORCHSCRIPT_REFUSAL)
                if any(member.compress_type for member in members):
                    raise ValueError("it is packed")
                for member in members:
                    if member.filename.endswith("/data.pkl"):
                        _check_globals(archive.read(member))
        if isinstance(stream, io.BytesIO):
            stream.seek(0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the problems that they announce raise errors
            import torch

            return torch.load(stream, map_location="cpu", weights_only=True, mmap=mapped and zipped)
    except pickle.UnpicklingError as bad:
        code = re.search(r"nsupported (?:global: )?GLOBAL (\S+)", str(bad))
        if code is None:
            raise ValueError("it cannot be unpickled") from None
        raise CodeError(code[1]) from None
    except Exception as bad:  # a damaged file raises almost anything
        if isinstance(bad, OSError) and bad.errno is not None:
            raise
        lines = str(bad).strip().splitlines()
        reason = f"{type(bad).__name__} {lines[0][:200] if lines else ''}"
        raise ValueError(reason.removeprefix("ValueError ").strip()) from None
