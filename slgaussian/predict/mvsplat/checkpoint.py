"""Loading of published checkpoints, without running code and with strict matching of tensors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from slgaussian.errors import InputError
from slgaussian.formats import tensorfile
from slgaussian.predict.mvsplat.network import Network

PREFIX = "encoder."


def load_network(path: str | Path) -> Network:
    """Load the network with the weights of ``path``, float32 on the CPU, in evaluation mode.

    Raises:
        InputError: If the file cannot be read, or the names or shapes of its tensors differ from
            the network's.
    """
    state = read_state(path)
    with torch.device("meta"):
        network = Network()
    expected = network.state_dict()
    common = expected.keys() & state.keys()
    problems = {
        "missing": expected.keys() - state.keys(),
        "unexpected": state.keys() - expected.keys(),
        "of another shape": {n for n in common if state[n].shape != expected[n].shape},
    }
    if any(problems.values()):
        summary = "; ".join(f"{len(p)} {kind}: {min(p)}" for kind, p in problems.items() if p)
        raise InputError(
            f"checkpoint {path}: does not fit the network of {len(expected)} tensors "
            f"({summary}, ...); expected re10k.ckpt or acid.ckpt of MVSplat, or one of the same "
            "shape"
        )
    state = {name: state[name].to(torch.float32, copy=True) for name in expected}
    network.load_state_dict(state, assign=True)
    network.eval().requires_grad_(False)
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


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
    items = state.items() if isinstance(state, Mapping) else ()
    state = {str(n): t for n, t in items if torch.is_tensor(t) and t.layout == torch.strided}
    if any(name.startswith(PREFIX) for name in state):
        # Beside the encoder, a checkpoint may hold buffers of the training losses.
        state = {n.removeprefix(PREFIX): t for n, t in state.items() if n.startswith(PREFIX)}
    return state
