"""Files of ``torch.save``, from anywhere: read so that nothing in them is ever run."""

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
"""Letters of the longest name of code that is looked at: torch takes the square of them in time."""

PICKLES = 5
"""Pickles in a file that is no zip archive: three about the format, the content, its tensors."""


SCRIPTED = (
    "it is a TorchScript archive, which holds code; if you trust it, save its tensors alone: "
    "torch.save(torch.jit.load(FILE, map_location='cpu').state_dict(), NEW_FILE)"
)
"""The reason to refuse a file of ``torch.jit.save``, as OpenAI publishes CLIP."""


class CodeError(ValueError):
    """A file that asks for code to be run; its text is the name of what it asks for."""


def load(source: Path | bytes, mapped: bool = False) -> Any:
    """Load a file on the CPU, by PyTorch's restricted unpickler.

    Parameters
    ----------
    source : path or bytes
    mapped : bool
        Map a file into memory where that is possible, so that only what is used is read.

    Raises
    ------
    CodeError
        If there is more in it than plain data and tensors.
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged, a TorchScript archive, or packed: ``torch.save`` packs nothing, and what
        unpacks to a thousandfold could fill the memory.
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
            warnings.simplefilter("ignore")  # what they warn of ends in an error
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
    """ValueError if one of so many pickles has a name of too many letters; none is unpickled."""
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
        except Exception:  # what is no pickle raises almost anything
            raise ValueError("it cannot be unpickled") from None
        if longest > LONGEST:
            raise ValueError(f"it has a name of {longest} letters")
