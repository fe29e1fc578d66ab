"""Models of ``transformers``: found in a folder or the hub's cache, known by content, loaded whole.

A model is a folder with ``config.json`` and ``model.safetensors`` (or the parts that
``model.safetensors.index.json`` lists), as ``save_pretrained`` writes it, or the name of one on
the Hugging Face hub. Weights in other formats could run code, so they are not read.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from slgaussian.errors import InputError
from slgaussian.store import sha256_of

CONFIG, WEIGHTS, INDEX = "config.json", "model.safetensors", "model.safetensors.index.json"


@dataclass(frozen=True)
class Family:
    """The models that a part can use.

    Attributes
    ----------
    part : str
        Name of the part in its registry, for messages.
    class_name : str
        Class of ``transformers`` that they are loaded as.
    types : tuple of str
        Values of ``model_type`` in ``config.json`` that fit.
    example : str
        A name on the hub.
    """

    part: str
    class_name: str
    types: tuple[str, ...]
    example: str


def load_pretrained(model: str | Path | None, family: Family, device: str = "auto") -> Any:
    """The model in float32, ready to infer, without gradients.

    The same content on the same device is loaded once and shared: do not change it.

    Parameters
    ----------
    model : path or str
        Folder, or name on the hub. What the hub's cache holds is not asked for again.
    family : Family
    device : str
        As PyTorch names it; "auto" is "cuda" where there is one, else "cpu".

    Raises
    ------
    InputError
        If ``transformers`` is not installed, there is no such model, it is of another
        architecture, its files are damaged, tensors are missing or of another shape, or the device
        cannot be used.
    """
    part = family.part
    try:
        import transformers  # noqa: F401
    except ImportError as problem:
        raise InputError(
            f"{part}: needs the package transformers ({problem}); "
            "install it with: pip install 'slgaussian[models]'"
        ) from None
    if model is None:
        raise InputError(
            f"{part} model: none given; give a folder, or a name on the hub as in "
            f"--{part}-model {family.example}"
        )
    folder = model_folder(model)
    _check_type(folder, family)
    return _loaded(folder, model_digest(folder), family, chosen_device(device))


@lru_cache(maxsize=2)
def _loaded(folder: Path, digest: str, family: Family, device: str) -> Any:
    """The model of :func:`load_pretrained`; two are kept, as a run uses for all its scenes."""
    import transformers

    try:
        with _quiet():
            loaded, report = getattr(transformers, family.class_name).from_pretrained(
                folder,
                local_files_only=True,
                use_safetensors=True,
                dtype=torch.float32,
                output_loading_info=True,
            )
    except Exception as problem:  # it raises what its layers raise, of any kind
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"model {folder}: cannot be loaded as {family.class_name} ({reason}); get it again, "
            f"or give another one, such as {family.example}"
        ) from None
    missing = sorted(report["missing_keys"])
    if missing:
        raise InputError(
            f"model {folder}: lacks {len(missing)} of the tensors of {family.class_name}, such as "
            f"{missing[0]}; get it again, or give another one, such as {family.example}"
        )
    try:
        return loaded.eval().requires_grad_(False).to(device)
    except (RuntimeError, AssertionError) as problem:
        reason = str(problem).splitlines()[0]
        raise InputError(f"{family.part} device {device!r}: cannot be used ({reason})") from None


def chosen_device(device: str) -> str:
    """The device itself, or for "auto" the best one."""
    if device != "auto":
        return device
    return "cuda" if torch.cuda.is_available() else "cpu"


def model_folder(model: str | Path) -> Path:
    """The folder of a model, downloaded to the hub's cache if it is a name that is not there yet.

    Raises
    ------
    InputError
        If there is no such folder or name, the hub cannot be reached, or the folder holds no model.
    """
    path = Path(model)
    if path.is_dir():
        _files(path)
        return path
    if path.exists():
        raise InputError(
            f"model {model}: is a file; expected a folder with {CONFIG} and {WEIGHTS}, or a name "
            "on the hub"
        )
    name = str(model)
    if name.count("/") != 1 or name.startswith((".", "~", "/")):
        raise InputError(
            f"model {model}: there is no such folder; expected one with {CONFIG} and {WEIGHTS}, or "
            "a name on the hub, such as OWNER/NAME"
        )
    try:
        from huggingface_hub import snapshot_download
    except ImportError as problem:
        raise InputError(
            f"model {model}: is no folder, and the hub needs the package huggingface_hub "
            f"({problem}); install it with: pip install 'slgaussian[models]'"
        ) from None
    wanted = [CONFIG, WEIGHTS, INDEX, "model-*.safetensors"]
    with contextlib.suppress(OSError, ValueError, InputError):
        cached = Path(snapshot_download(name, allow_patterns=wanted, local_files_only=True))
        _files(cached)
        return cached
    try:
        folder = Path(snapshot_download(name, allow_patterns=wanted))
    except (OSError, ValueError) as problem:
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"model {model}: there is no such folder, the hub's cache does not hold it, and it "
            f"could not be downloaded ({reason}); check the spelling, or download it elsewhere and "
            "give the folder"
        ) from None
    _files(folder)
    return folder


def model_digest(model: str | Path) -> str:
    """What a model is known by: SHA-256, hexadecimal, over its configuration and weights.

    Raises
    ------
    InputError
        As :func:`model_folder`.
    """
    digest = hashlib.sha256()
    for file in _files(model_folder(model)):
        state = file.stat()
        content = _digest_of(file.resolve(), state.st_size, state.st_mtime_ns)
        digest.update(f"{file.name} {content}\n".encode())
    return digest.hexdigest()


@lru_cache(maxsize=64)
def _digest_of(file: Path, size: int, changed: int) -> str:
    """SHA-256 of a file of gigabytes, taken once for each size and time of change."""
    return sha256_of(file)


def _files(folder: Path) -> list[Path]:
    """Configuration and weights, in order of their names; InputError if one is missing."""
    files = [folder / CONFIG]
    if not (folder / WEIGHTS).is_file() and (folder / INDEX).is_file():
        parts = _json(folder / INDEX).get("weight_map", {}).values()
        files += [folder / INDEX, *(folder / part for part in sorted(set(parts)))]
    else:
        files.append(folder / WEIGHTS)
    for file in files:
        if not file.is_file():
            raise InputError(
                f"model {folder}: has no {file.name}; expected a folder as save_pretrained of "
                f"transformers writes it, with {CONFIG} and {WEIGHTS}"
            )
    return files


def _check_type(folder: Path, family: Family) -> None:
    found = _json(folder / CONFIG).get("model_type")
    if found not in family.types:
        raise InputError(
            f"model {folder}: is of type {found!r}, but {family.part} needs "
            f"{' or '.join(map(repr, family.types))}, such as {family.example}"
        )


def _json(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read as JSON ({problem}); get it again") from None
    return content if isinstance(content, dict) else {}


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """No bars and no tables on the way: what is wrong with a model is said in one sentence."""
    from transformers.utils import logging

    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()
