"""Files of ``torch.save``, from anywhere: read so that nothing in them is ever run."""

from __future__ import annotations

import io
import pickle
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch


class CodeError(ValueError):
    """A file that asks for code to be run; its text is the name of what it asks for."""


def load(source: Path | bytes, mapped: bool = False) -> Any:
    """What a file holds, on the CPU, by PyTorch's restricted unpickler.

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
        If it is damaged, or packed: ``torch.save`` packs nothing, and what unpacks to a
        thousandfold could fill the memory.
    """
    stream = io.BytesIO(source) if isinstance(source, bytes) else source
    try:
        zipped = zipfile.is_zipfile(stream)
        if zipped:
            with zipfile.ZipFile(stream) as archive:
                if any(member.compress_type for member in archive.infolist()):
                    raise ValueError("it is packed")
        if isinstance(stream, io.BytesIO):
            stream.seek(0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what they warn of ends in an error
            return torch.load(stream, map_location="cpu", weights_only=True, mmap=mapped and zipped)
    except pickle.UnpicklingError as bad:
        code = re.search(r"nsupported (?:global: )?GLOBAL (\S+)", str(bad))
        if code is None:
            raise ValueError("it cannot be unpickled") from None
        raise CodeError(code[1]) from None
    except Exception as bad:  # a damaged file raises almost anything
        if isinstance(bad, OSError) and bad.errno is not None:
            raise
        said = str(bad).strip().splitlines()
        reason = f"{type(bad).__name__} {said[0][:200] if said else ''}"
        raise ValueError(reason.removeprefix("ValueError ").strip()) from None
