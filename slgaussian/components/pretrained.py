"""Models of ``transformers``: found in a folder or the hub's cache, known by content, loaded whole.

A model is a folder with ``config.json`` and ``model.safetensors`` (or the parts that
``model.safetensors.index.json`` lists), as ``save_pretrained`` writes it, or the name of one on
the Hugging Face hub. Where a component converts them, it may also be a checkpoint of open_clip:
a file, or a folder or name on the hub with one of :data:`OPEN_CLIP_WEIGHTS`. Other formats could
run code, so they are not read.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from slgaussian.components.hub_cache import hub_download, is_hub_name
from slgaussian.errors import InputError
from slgaussian.extras import install_line
from slgaussian.formats import strict_json
from slgaussian.io import file_digest

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
"""Files of tokenizers that ``transformers`` reads where they are there."""


@dataclass(frozen=True)
class Family:
    """The models that a component can use.

    Attributes
    ----------
    part : str
        Name of the component, for messages.
    class_name : str
        Class of ``transformers`` that they are loaded as.
    types : tuple of str
        Values of ``model_type`` in ``config.json`` that fit.
    example : str
        A name on the hub.
    convert : callable, optional
        Makes the network of a checkpoint of open_clip, for components that can use one.
    """

    part: str
    class_name: str
    types: tuple[str, ...]
    example: str
    convert: Callable[[ModelFiles], Any] | None = None


def load_pretrained(model: str | Path | None, family: Family, device: str = "auto") -> Any:
    """Load a model in float32, ready to infer, without gradients.

    The same content on the same device is loaded once and shared: do not change it.

    Parameters
    ----------
    model : path or str
        Folder, name on the hub, or where the family has a converter, a checkpoint of open_clip.
        What the hub's cache holds is not asked for again.
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
            f"install it with {install_line('models')}"
        ) from None
    if model is None:
        raise InputError(
            f"{part} model: none given; give a folder, or a name on the hub as in "
            f"--set {part.replace('-', '_')}.model={family.example}"
        )
    model_files = find_model(model)
    if model_files.checkpoint is None:
        kind = read_json(model_files.folder / CONFIG).get("model_type")
        if kind not in family.types:
            raise InputError(
                f"model {model_files.folder}: is of type {kind!r}, but {part} needs "
                f"{' or '.join(map(repr, family.types))}, such as {family.example}"
            )
    elif family.convert is None:
        raise InputError(
            f"model {model}: is a file, or of open_clip; {part} expected a folder with {CONFIG} "
            f"and {WEIGHTS}, or a name on the hub, such as {family.example}"
        )
    return _loaded(model_files, model_digest(model), family, chosen_device(device))


@lru_cache(maxsize=4)
def _loaded(model_files: ModelFiles, digest: str, family: Family, device: str) -> Any:
    """The model of :func:`load_pretrained`; a few are kept, as a run uses for all its scenes."""
    if model_files.checkpoint is None or family.convert is None:
        loaded = _load_folder(model_files.folder, family)
    else:
        loaded = family.convert(model_files)
    try:
        return loaded.eval().requires_grad_(False).to(device)
    except (RuntimeError, AssertionError) as problem:
        reason = str(problem).splitlines()[0]
        raise InputError(f"{family.part} device {device!r}: cannot be used ({reason})") from None


def load_tokenizer(place: str | Path, class_name: str) -> Any:
    """Load the tokenizer of a class of ``transformers``, found by :func:`find_tokenizer`.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.
    """
    import transformers

    folder = find_tokenizer(place)
    try:
        with quiet():
            return getattr(transformers, class_name).from_pretrained(folder, local_files_only=True)
    except Exception as problem:  # it raises what its parsers raise, of any kind
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"tokenizer {folder}: cannot be loaded as {class_name} ({reason}); get it again"
        ) from None


def _load_folder(folder: Path, family: Family) -> Any:
    import torch
    import transformers

    try:
        with quiet():
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
    return loaded


def chosen_device(device: str) -> str:
    """Return the device itself, or for "auto" the best one."""
    if device != "auto":
        return device
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


@dataclass(frozen=True)
class ModelFiles:
    """Files of a model.

    Attributes
    ----------
    folder : Path
        Where it is, and with it what else belongs to it, such as a tokenizer.
    files : tuple of Path
        Configuration and weights.
    checkpoint : Path or None
        The weights, if they are open_clip's, which is the last of ``files`` then.
    """

    folder: Path
    files: tuple[Path, ...]
    checkpoint: Path | None = None


def find_model(model: str | Path) -> ModelFiles:
    """Find the files of a model, downloaded to the hub's cache if it is a name not there yet.

    Raises
    ------
    InputError
        If there is no such folder, file or name, the hub cannot be reached, or the folder holds no
        model.
    """
    path = Path(model)
    if path.is_dir():
        return _files_of_model(path)
    if path.is_file():
        config = path.parent / OPEN_CLIP_CONFIG
        return ModelFiles(path.parent, (config, path) if config.is_file() else (path,), path)
    beside = [CONFIG, OPEN_CLIP_CONFIG, PREPROCESSOR, *TOKENIZER]
    formats = [[WEIGHTS, INDEX, "model-*.safetensors"], *([name] for name in OPEN_CLIP_WEIGHTS)]
    wanted = [beside + weights for weights in formats]
    return _files_of_model(
        _from_hub("model", model, wanted, f"one with {CONFIG} and {WEIGHTS}", _files_of_model)
    )


def find_tokenizer(place: str | Path) -> Path:
    """Find a tokenizer: a folder, or a name on the hub, with any of :data:`TOKENIZER`.

    Raises
    ------
    InputError
        If there is none, or the hub cannot be reached.
    """
    if Path(place).is_dir():
        _tokenizer_files(Path(place))
        return Path(place)
    expected = "one with tokenizer.json, or vocab.json and merges.txt"
    return _from_hub("tokenizer", place, [list(TOKENIZER)], expected, _tokenizer_files)


def _from_hub(
    kind: str,
    name: str | Path,
    wanted: Sequence[list[str]],
    expected: str,
    check: Callable[[Path], object],
) -> Path:
    """The hub's cached folder of a name; the first of the ``wanted`` files that pass the check."""
    name = str(name)
    if not is_hub_name(name):
        raise InputError(
            f"{kind} {name}: there is no such folder; expected {expected}, or a name on the hub, "
            "such as OWNER/NAME"
        )
    snapshot_download = hub_download(f"{kind} {name}")
    with contextlib.suppress(OSError, ValueError, InputError):
        cached = Path(snapshot_download(name, local_files_only=True))
        check(cached)
        return cached
    for patterns in wanted:
        try:
            folder = Path(snapshot_download(name, allow_patterns=patterns))
        except (OSError, ValueError) as problem:
            reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
            raise InputError(
                f"{kind} {name}: there is no such folder, the hub's cache does not hold it, and it "
                f"could not be downloaded ({reason}); check the spelling, or download it elsewhere "
                "and give the folder"
            ) from None
        with contextlib.suppress(InputError):
            check(folder)
            return folder
    check(folder)
    return folder


def model_digest(model: str | Path) -> str:
    """Compute the SHA-256 of a model, hexadecimal, over its configuration and weights.

    And over the files beside them that say how images and texts are brought to it.

    Raises
    ------
    InputError
        As :func:`find_model`.
    """
    model_files = find_model(model)
    beside = [model_files.folder / name for name in (PREPROCESSOR, *TOKENIZER)]
    # The name of a checkpoint is the user's own.
    named = {
        "checkpoint" if file == model_files.checkpoint else file.name: file
        for file in model_files.files
    }
    return _digest(named | {file.name: file for file in beside if file.is_file()})


def tokenizer_digest(place: str | Path) -> str:
    """Compute the SHA-256 of a tokenizer, hexadecimal; InputError as in :func:`find_tokenizer`.

    Only its own files count, whatever else the folder holds.
    """
    return _digest({file.name: file for file in _tokenizer_files(find_tokenizer(place))})


def _digest(files: Mapping[str, Path]) -> str:
    digest = hashlib.sha256()
    for name, file in files.items():
        digest.update(f"{name} {file_digest(file)}\n".encode())
    return digest.hexdigest()


def _tokenizer_files(folder: Path) -> list[Path]:
    files = [folder / name for name in TOKENIZER if (folder / name).is_file()]
    names = {file.name for file in files}
    if not names & {"tokenizer.json", "vocab.txt"} and not names >= {"vocab.json", "merges.txt"}:
        raise InputError(
            f"tokenizer {folder}: holds none; expected tokenizer.json, or vocab.json and merges.txt"
        )
    return files


def _files_of_model(folder: Path) -> ModelFiles:
    """The files of the model in a folder; InputError if one is missing."""
    present = [(folder / name).is_file() for name in (WEIGHTS, INDEX)]
    if not any(present):
        for name in OPEN_CLIP_WEIGHTS:
            if (folder / name).is_file():
                return find_model(folder / name)
    files = [folder / CONFIG]
    if present == [False, True]:
        index = folder / INDEX
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


def read_json(file: Path) -> dict[str, Any]:
    """Read the object in a JSON file; InputError if it cannot be read."""
    try:
        content = strict_json.parse(file.read_bytes())
    except (OSError, ValueError) as problem:
        raise InputError(f"{file}: cannot be read as JSON ({problem}); get it again") from None
    return content if isinstance(content, dict) else {}


def table_in(content: Mapping[str, Any], key: str, file: Path) -> Mapping[str, Any]:
    """Return the object under a key of a JSON file, empty where there is none; else InputError."""
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{file}: {key} is {table!r:.60}, expected an object; get it again")
    return table


@contextlib.contextmanager
def quiet() -> Iterator[None]:
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
