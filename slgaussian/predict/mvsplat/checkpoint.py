"""Loading of published checkpoints, without running code and with strict matching of tensors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from slgaussian.errors import InputError
from slgaussian.formats import tensorfile
from slgaussian.predict.mvsplat.config import PUBLISHED, Config
from slgaussian.predict.mvsplat.network import Network

PREFIX = "encoder."


def load_network(path: str | Path, config: Config = PUBLISHED) -> Network:
    """Load the network with the weights of ``path``, float32 on the CPU, in evaluation mode.

    Raises:
        InputError: If the file cannot be read, holds no named tensors, or its names or shapes
            differ from the network's.
    """
    return with_weights(read_state(path), config, str(path))


def read_state(path: str | Path) -> dict[str, torch.Tensor]:
    """Read tensors by name from a Lightning checkpoint or a bare state dictionary.

    A prefix ``encoder.`` is removed.

    Raises:
        InputError: If the file cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            f"checkpoint {path}: there is no such file; download re10k.ckpt from where MVSplat's "
            "README says, and give its path"
        )
    try:
        # Memory-mapped, so that other content, such as an optimiser's state, is not read.
        stored = tensorfile.load(path, mapped=True)
    except tensorfile.CodeError as code:
        raise InputError(
            f"checkpoint {path}: holds more than tensors ({code}), which could run code; if you "
            "trust it, save the state_dict of torch.load(path, weights_only=False) to a new file, "
            "and give that"
        ) from None
    except (OSError, ValueError) as problem:
        raise InputError(
            f"checkpoint {path}: is damaged or no PyTorch file ({problem}); download it again"
        ) from None
    state = stored.get("state_dict", stored) if isinstance(stored, Mapping) else {}
    state = state if isinstance(state, Mapping) else {}
    state = {
        str(name): value
        for name, value in state.items()
        if torch.is_tensor(value) and value.layout == torch.strided
    }
    if any(name.startswith(PREFIX) for name in state):
        # Beside the encoder, a checkpoint may hold buffers of the training losses.
        state = {n.removeprefix(PREFIX): t for n, t in state.items() if n.startswith(PREFIX)}
    return state


def with_weights(state: Mapping[str, torch.Tensor], config: Config, origin: str) -> Network:
    """Make a network with exactly the tensors of ``state``; ``origin`` names them in errors.

    Raises:
        InputError: If a name is missing or unexpected, or a shape differs.
    """
    with torch.device("meta"):
        network = Network(config)
    expected = network.state_dict()
    problems = {
        "missing": expected.keys() - state.keys(),
        "unexpected": state.keys() - expected.keys(),
        "of another shape": {
            name
            for name in expected.keys() & state.keys()
            if state[name].shape != expected[name].shape
        },
    }
    if any(problems.values()):
        summary = "; ".join(f"{len(p)} {kind}: {min(p)}" for kind, p in problems.items() if p)
        raise InputError(
            f"checkpoint {origin}: does not fit the network of {len(expected)} tensors "
            f"({summary}, ...); expected re10k.ckpt or acid.ckpt of MVSplat, or one of the same "
            "shape"
        )
    state = {name: state[name].to(torch.float32, copy=True) for name in expected}
    network.load_state_dict(state, assign=True)
    network.eval().requires_grad_(False)
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
