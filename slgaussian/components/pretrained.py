"""Loading of ``transformers`` models from folders or the hub's cache, and their digests.

A model is a folder with ``config.json`` and ``model.safetensors`` (or the parts that
``model.safetensors.index.json`` lists), as written by ``save_pretrained``, or the name of such a
model on the Hugging Face hub. If the component has a converter, it may also be a checkpoint of
open_clip: a file, or a folder or name on the hub with one of :data:`OPEN_CLIP_WEIGHTS`. Other
formats are not read because they may execute code.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from slgaussian.components.config import ComponentConfig
from slgaussian.errors import InputError
from slgaussian.extras import install_line
from slgaussian.formats import strict_json
from slgaussian.io import file_digest, file_sha256

CONFIG, WEIGHTS, INDEX = "config.json", "model.safetensors", "model.safetensors.index.json"
OPEN_CLIP_CONFIG = "open_clip_config.json"
OPEN_CLIP_WEIGHTS = ("open_clip_model.safetensors", "open_clip_pytorch_model.bin")
PREPROCESSOR = "preprocessor_config.json"
TOKENIZER = (
    "tokenizer.json",
    "vocab.json",
    "merges.txt",
    "vocab.txt",
    "tokenizer_config.json",
    "special_tokens_map.json",
    "added_tokens.json",
)
"""Files of tokenizers that ``transformers`` reads if present."""


@dataclass(frozen=True)
class Family:
    """The models that a component supports.

    Attributes:
        component: Its name, for messages.
        class_name: Class of ``transformers`` to load.
        types: tuple of str. Supported values of ``model_type`` in ``config.json``.
        example: A name on the hub.
        convert: Converts a checkpoint of open_clip to the network, if the component supports that.
    """

    component: str
    class_name: str
    types: tuple[str, ...]
    example: str
    convert: Callable[[ModelFiles], Any] | None = None


def load_pretrained(model: str | Path | None, family: Family, device: str = "auto") -> Any:
    """Load a model in float32 for inference, without gradients.

    The same content on the same device is loaded once and shared: do not change it.

    Args:
        model: Folder, name on the hub, or if the family has a converter, a checkpoint of open_clip.
            Files in the hub's cache are used without asking the hub.
        device: PyTorch device; "auto" is "cuda" if available, else "cpu".

    Raises:
        InputError: If ``transformers`` is not installed, the model is missing or of another
            architecture, its files are damaged, tensors are missing or have other shapes, or the
            device cannot be used.
    """
    component = family.component
    try:
        import transformers  # noqa: F401
    except ImportError as problem:  # missing, or broken by another package
        raise InputError(
            f"{component}: needs the package transformers ({problem}); "
            f"install it with {install_line('models')}"
        ) from None
    if model is None:
        raise InputError(
            f"{component} model: none given; give a folder, or a name on the hub as in "
            f"--set {component.replace('-', '_')}.model={family.example}"
        )
    model_files = find_model(model)
    if model_files.checkpoint is None:
        kind = read_json(model_files.folder / CONFIG).get("model_type")
        if kind not in family.types:
            raise InputError(
                f"model {model_files.folder}: is of type {kind!r}, but {component} needs "
                f"{' or '.join(map(repr, family.types))}, such as {family.example}"
            )
    elif family.convert is None:
        raise InputError(
            f"model {model}: is a file, or of open_clip; {component} expected a folder with "
            f"{CONFIG} and {WEIGHTS}, or a name on the hub, such as {family.example}"
        )
    return _load(model_files, model_digest(model), family, resolve_device(device))


@lru_cache(maxsize=4)
def _load(model_files: ModelFiles, digest: str, family: Family, device: str) -> Any:
    """Load the model of :func:`load_pretrained`; cached, as all scenes of a run use the same."""
    if model_files.checkpoint is None or family.convert is None:
        network = _load_folder(model_files.folder, family)
    else:
        network = family.convert(model_files)
    try:
        return network.eval().requires_grad_(False).to(device)
    except (RuntimeError, AssertionError) as problem:
        reason = f"cannot be used ({str(problem).splitlines()[0]})"
        raise InputError(f"{family.component} device {device!r}: {reason}") from None


def load_tokenizer(place: str | Path, class_name: str) -> Any:
    """Load a tokenizer of a ``transformers`` class, located by :func:`find_tokenizer`.

    Raises:
        InputError: If it is missing or cannot be read.
    """
    import transformers

    folder = find_tokenizer(place)[0].parent
    try:
        with quiet_transformers():
            return getattr(transformers, class_name).from_pretrained(folder, local_files_only=True)
    except Exception as problem:  # its parsers raise errors of any type
        raise InputError(
            f"tokenizer {folder}: cannot be loaded as {class_name} ({_reason(problem)}); get it "
            "again"
        ) from None


def _load_folder(folder: Path, family: Family) -> Any:
    import torch
    import transformers

    name, advice = family.class_name, f"get it again, or give another one, such as {family.example}"
    try:
        with quiet_transformers():
            loaded, report = getattr(transformers, name).from_pretrained(
                folder,
                local_files_only=True,
                use_safetensors=True,
                dtype=torch.float32,
                output_loading_info=True,
            )
    except Exception as problem:  # its layers raise errors of any type
        raise InputError(
            f"model {folder}: cannot be loaded as {name} ({_reason(problem)}); {advice}"
        ) from None
    if missing := sorted(report["missing_keys"]):
        raise InputError(
            f"model {folder}: lacks {len(missing)} of the tensors of {name}, such as "
            f"{missing[0]}; {advice}"
        )
    return loaded


def _reason(problem: Exception) -> str:
    return f"{type(problem).__name__}: {problem}".splitlines()[0]


def resolve_device(device: str) -> str:
    """Return the device itself, or for "auto" the fastest available one."""
    if device != "auto":
        return device
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


@dataclass(frozen=True)
class ModelFiles:
    """Files of a model.

    Attributes:
        folder: Folder of the model and of its other files, such as a tokenizer.
        files: tuple of Path. Configuration and weights.
        checkpoint: The last of ``files`` if it is a checkpoint of open_clip.
    """

    folder: Path
    files: tuple[Path, ...]
    checkpoint: Path | None = None


def find_model(model: str | Path, download: bool = True) -> ModelFiles:
    """Find the files of a model; download a name that is not in the hub's cache.

    Raises:
        InputError: If there is no such folder, file or name, the hub cannot be reached, or the
            folder contains no model; without ``download``, also if the cache does not hold it.
    """
    if Path(model).is_file():
        return _checkpoint(Path(model))
    configs = [CONFIG, OPEN_CLIP_CONFIG, PREPROCESSOR, *TOKENIZER]
    formats = [[WEIGHTS, INDEX, "model-*.safetensors"], *([name] for name in OPEN_CLIP_WEIGHTS)]
    patterns = [configs + weights for weights in formats] if download else []
    return _find("model", model, _files_of_model, f"one with {CONFIG} and {WEIGHTS}", patterns)


def find_tokenizer(place: str | Path, download: bool = True) -> list[Path]:
    """Find the files of a tokenizer, given as a folder or name on the hub.

    Raises:
        InputError: If its files are missing, or the hub cannot be reached; as :func:`find_model`.
    """
    expected = "one with tokenizer.json, or vocab.json and merges.txt"
    patterns = [list(TOKENIZER)] if download else []
    return _find("tokenizer", place, _files_of_tokenizer, expected, patterns)


def _find(
    kind: str,
    place: str | Path,
    read: Callable[[Path], Any],
    expected: str,
    patterns: Sequence[list[str]],
) -> Any:
    """Read a folder, or that of a name in the hub's cache; else download by one of ``patterns``."""
    if Path(place).is_dir():
        return read(Path(place))
    name = str(place)
    if name.count("/") != 1 or name.startswith((".", "~", "/")):
        raise InputError(
            f"{kind} {name}: there is no such folder; expected {expected}, or a name on the hub, "
            "such as OWNER/NAME"
        )
    try:
        from huggingface_hub import snapshot_download
    except ImportError as problem:
        raise InputError(
            f"{kind} {name}: is no folder here, and the hub needs the package huggingface_hub "
            f"({problem}); install it with {install_line('models')}"
        ) from None
    with contextlib.suppress(OSError, ValueError):
        return read(Path(snapshot_download(name, local_files_only=True)))
    reason = "download it once"
    for files in patterns:
        try:
            return read(Path(snapshot_download(name, allow_patterns=files)))
        except (OSError, ValueError) as error:
            reason = _reason(error)
    raise InputError(
        f"{kind} {name}: there is no such folder, and the hub's cache does not hold it ({reason}); "
        f"check the spelling, or run `hf download {name}` where there is a network"
    )


def model_digest(model: str | Path) -> str:
    """Compute the SHA-256 of a model, hexadecimal.

    It covers configuration, weights, and the settings of image preprocessor and tokenizer.

    Raises:
        InputError: As in :func:`find_model`.
    """
    model_files = find_model(model)
    config_files = [model_files.folder / name for name in (PREPROCESSOR, *TOKENIZER)]
    files = [*model_files.files, *(file for file in config_files if file.is_file())]
    # A checkpoint may have any file name.
    return _digest({"checkpoint" if f == model_files.checkpoint else f.name: f for f in files})


def tokenizer_digest(place: str | Path) -> str:
    """Compute the SHA-256 of a tokenizer, hexadecimal; InputError as in :func:`find_tokenizer`.

    Other files in the folder have no effect.
    """
    return _digest({file.name: file for file in find_tokenizer(place)})


def check_component(component: ComponentConfig) -> str:
    """Check the files of a component, and return a sentence about them; empty without files.

    Nothing is downloaded. Weights in the hub's cache are compared with the hub's digests. Models
    are loaded, which checks their configuration and the names and shapes of tensors; their weights
    must be finite. InputError if a file is missing, damaged, or not what the component needs.
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
            raise InputError(f"{label}: {name} holds NaN or infinity; get it again")
    of_hub = verified and all(verified)
    verdict = "is what the hub has, by its SHA-256" if of_hub else "can be loaded"
    return f"{label}: {verdict}" if label else ""


def is_of_hub(file: Path) -> bool:
    """Return whether a file is in the hub's cache; InputError if it has not the cached SHA-256."""
    stored = file.resolve()
    if not re.fullmatch("[0-9a-f]{64}", stored.name):
        return False
    try:
        digest = file_sha256(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); get it again") from error
    if stored.name != digest:
        raise InputError(
            f"{file}: is damaged: its SHA-256 begins with {digest[:8]}, and of the file on the hub "
            f"with {stored.name[:8]}; delete {stored} and get it again"
        )
    return True


def _digest(files: Mapping[str, Path]) -> str:
    digest = hashlib.sha256()
    for name, file in files.items():
        digest.update(f"{name} {file_digest(file)}\n".encode())
    return digest.hexdigest()


def _files_of_tokenizer(folder: Path) -> list[Path]:
    files = [folder / name for name in TOKENIZER if (folder / name).is_file()]
    names = {file.name for file in files}
    if not names & {"tokenizer.json", "vocab.txt"} and not names >= {"vocab.json", "merges.txt"}:
        raise InputError(
            f"tokenizer {folder}: holds none; expected tokenizer.json, or vocab.json and merges.txt"
        )
    return files


def _files_of_model(folder: Path) -> ModelFiles:
    """Find the files of the model in a folder; InputError if one is missing."""
    index, has_weights = folder / INDEX, (folder / WEIGHTS).is_file()
    if not has_weights and not index.is_file():
        for name in OPEN_CLIP_WEIGHTS:
            if (folder / name).is_file():
                return _checkpoint(folder / name)
    files = [folder / CONFIG]
    if index.is_file() and not has_weights:
        parts = table_in(read_json(index), "weight_map", index).values()
        for part in parts:
            if not isinstance(part, str) or Path(part).name != part or len(part) > 255:
                raise InputError(
                    f"{index}: weight_map names {part!r:.60}, expected a file beside it"
                )
        files += [index, *(folder / part for part in sorted(set(parts)))]
    else:
        files.append(folder / WEIGHTS)
    for file in files:
        if not file.is_file():
            raise InputError(
                f"model {folder}: has no {file.name}; expected a folder as save_pretrained of "
                f"transformers writes it, with {CONFIG} and {WEIGHTS}"
            )
    return ModelFiles(folder, tuple(files))


def _checkpoint(file: Path) -> ModelFiles:
    config = file.parent / OPEN_CLIP_CONFIG
    return ModelFiles(file.parent, (config, file) if config.is_file() else (file,), file)


def read_json(file: Path) -> dict[str, Any]:
    """Read the object in a JSON file; InputError if it cannot be read."""
    try:
        content = strict_json.parse(file.read_bytes())
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read as JSON ({problem}); get it again") from None
    return content if isinstance(content, dict) else {}


def table_in(content: Mapping[str, Any], key: str, file: Path) -> Mapping[str, Any]:
    """Return the object at a key of a JSON file, empty if missing; InputError for other types."""
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{file}: {key} is {table!r:.60}, expected an object; get it again")
    return table


@contextlib.contextmanager
def quiet_transformers() -> Iterator[None]:
    """Suppress progress bars and reports of ``transformers``; errors are raised in one sentence."""
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
