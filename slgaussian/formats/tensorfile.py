"""Reading of untrusted ``torch.save`` files without executing code."""

from __future__ import annotations

import io
import pickle
import pickletools
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

LONGEST = 200
"""Largest length of a global's name in a pickle: torch's check takes quadratic time."""

PICKLES = 5
"""Number of pickles in a legacy file: three for the format, the content, its tensors."""


SCRIPTED = (
    "it is a TorchScript archive, which holds code; if you trust it, save its tensors alone: "
    "torch.save(torch.jit.load(FILE, map_location='cpu').state_dict(), NEW_FILE)"
)
"""Message for files of ``torch.jit.save``, such as OpenAI's CLIP."""


class CodeError(ValueError):
    """A file requires code to be run; the message is the name of the global."""


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
        zipped = zipfile.is_zipfile(stream)
        if zipped:
            with zipfile.ZipFile(stream) as archive:
                if any("/code/" in member.filename for member in archive.infolist()):
                    raise ValueError(SCRIPTED)
                if any(member.compress_type for member in archive.infolist()):
                    raise ValueError("it is packed")
                for name in archive.namelist():
                    if name.endswith(".pkl"):
                        _check_names(io.BytesIO(archive.read(name)), 1)
        elif isinstance(stream, io.BytesIO):
            stream.seek(0)
            _check_names(stream, PICKLES)
        else:
            with stream.open("rb") as file:
                _check_names(file, PICKLES)
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


def _check_names(stream: BinaryIO, count: int) -> None:
    """Raise ValueError if one of ``count`` pickles has a name that is too long; unpickle none."""
    for _ in range(count):
        try:
            longest = max(
                (
                    len(name)
                    for code, name, _ in pickletools.genops(stream)
                    if code.name == "GLOBAL" and isinstance(name, str)
                ),
                default=0,
            )
        except Exception:  # an invalid pickle raises almost anything
            raise ValueError("it cannot be unpickled") from None
        if longest > LONGEST:
            raise ValueError(f"it has a name of {longest} letters")
