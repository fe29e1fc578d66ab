"""The semantic branch: network from code images to Gaussian features (paper, section 3.1)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import nn
from torch.nn import functional as F

from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import inside
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank
from slgaussian.semantic.hard import code_images
from slgaussian.semantic.versions import find_weights

DIMENSION = 3
"""Dimension of an ID code, as in the paper."""


@dataclass(frozen=True)
class Architecture:
    """Layers of a branch; weights of one architecture do not fit another.

    Attributes:
        widths: Channels at full resolution, then after each residual block that halves it.
        hidden: Width of the MLP's one hidden layer.
    """

    widths: tuple[int, ...] = (16, 32, 64, 64)
    hidden: int = 64


class Branch(nn.Module):
    """The network of the paper (section 3.1, Semantic Parameters Prediction).

    The code image M_i [3, H, W] passes through a convolution and residual blocks that each halve
    the resolution (He et al. 2016), is up-sampled back to the full one and added to M_i; an MLP
    maps each pixel of the sum to f_i, three numbers.

    The paper leaves open, and this implementation chooses: 3x3 convolutions, ReLU, widths, no
    normalisation (a batch is one scene), a 1x1 convolution to the three channels of M_i before
    bilinear up-sampling, one hidden layer, PyTorch's default initialisation. The weight channel is
    1: every Gaussian has an object, and a pixel without one is (0, 0, 0) in M_i.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        widths, hidden = architecture.widths, architecture.hidden
        self.stem = nn.Conv2d(DIMENSION, widths[0], 3, padding=1)
        self.down = nn.Sequential(*(_HalvingBlock(*pair) for pair in pairwise(widths)))
        self.up = nn.Conv2d(widths[-1], DIMENSION, 1)
        self.first = nn.Conv2d(DIMENSION, hidden, 1)
        self.last = nn.Conv2d(hidden, DIMENSION, 1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Compute float [V, H, W, 4], code and weight, of code images float [V, H, W, 3].

        The code is not clamped to [0, 1].
        """
        codes = images.permute(0, 3, 1, 2)
        coarse = self.up(self.down(F.relu(self.stem(codes))))
        mixed = codes + F.interpolate(coarse, codes.shape[-2:], mode="bilinear")
        features = self.last(F.relu(self.first(mixed))).permute(0, 2, 3, 1)
        return torch.cat([features, torch.ones_like(features[..., :1])], -1)


def make_branch(architecture: Architecture, seed: int = 0) -> Branch:
    """Make an untrained network; the same seed gives the same weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Branch(architecture)


class _HalvingBlock(nn.Module):
    """A residual block that halves the resolution, rounding odd sizes up."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.one = nn.Conv2d(before, after, 3, stride=2, padding=1)
        self.two = nn.Conv2d(after, after, 3, padding=1)
        self.past = nn.Conv2d(before, after, 1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        # Not a 1x1 convolution of stride 2: oneDNN's backward, channels last, corrupts the heap.
        halved = F.avg_pool2d(images, 2, ceil_mode=True)
        return F.relu(self.past(halved) + self.two(F.relu(self.one(images))))


@dataclass(frozen=True, eq=False)
class BranchLifting:
    """The lifting by a trained branch."""

    branch: Branch

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`."""
        images = input_images(label_maps.labels, bank.ids, bank.codes)
        with torch.no_grad(), inside(self.branch):
            features = compute_features(self.branch, images, gaussians.source)
        return replace(gaussians, features=features)


def load_branch_lifting(weights: str | Path | None = None) -> BranchLifting:
    """Load the lifting from a file or folder of weights.

    Raises:
        InputError: If ``weights`` is None, or the weights are missing or damaged.
    """
    if weights is None:
        raise InputError(
            "lifting 'branch': no weights are given; train some with `slgaussian train` and "
            "give the file, as --set branch.weights=trained/branch.safetensors, or choose the "
            "lifting 'hard'"
        )
    return BranchLifting(load_branch(find_weights(weights)))


def input_images(labels: np.ndarray, ids: np.ndarray, codes: np.ndarray) -> torch.Tensor:
    """Make the input images of a branch, float32 [V, H, W, 3]: codes, 0 where there is no object.

    Args:
        labels: int32 [V, H, W]. Object ids of the views.
        ids, codes: int32 [N], float32 [N, 3]. The ID code of each object.
    """
    return torch.from_numpy(code_images(labels, ids, codes)[..., :DIMENSION])


def compute_features(branch: Branch, images: torch.Tensor, source: torch.Tensor) -> torch.Tensor:
    """Compute the feature of each Gaussian, float32 [N, 4]: that of its ``source`` pixel, int [N].

    The network runs on the device of its weights; the result is on the CPU.
    """
    images = images.to(next(branch.parameters()).device)
    return branch(images).cpu().flatten(0, 2).index_select(0, source)


def save_branch(branch: Branch, trained: Mapping[str, Any] | None = None) -> bytes:
    """Encode weights, architecture and provenance (JSON data) as bytes of a safetensors file."""
    tensors = {name: t.detach().contiguous() for name, t in branch.state_dict().items()}
    metadata = {} if trained is None else {"trained": dict(trained)}
    statement = {"architecture": asdict(branch.architecture), **metadata}
    # One entry only: safetensors writes several in an order that differs from run to run.
    note = {"slgaussian": json.dumps(statement, sort_keys=True)}
    return safetensors.torch.save(dict(sorted(tensors.items())), note)


def load_branch(path: str | Path) -> Branch:
    """Read a file of :func:`save_branch`; the branch is in evaluation mode.

    Raises:
        InputError: If the file cannot be read, or is not a branch.
    """
    tensors, statement = read_tensors(path)
    try:
        values = statement["architecture"]
        architecture = Architecture(**{**values, "widths": tuple(values["widths"])})
    except (KeyError, TypeError):
        raise InputError(
            f"weights {path}: does not say which branch it is of, expected a file that "
            "`slgaussian train` wrote"
        ) from None
    try:
        with torch.device("meta"):
            branch = make_branch(architecture)
        branch.load_state_dict(tensors, assign=True)
    except (RuntimeError, TypeError, ValueError, OverflowError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[-1].strip()[:200]
        raise InputError(
            f"weights {path}: tensors are not those of the architecture that it says it is of "
            f"({reason}); train again"
        ) from None
    return branch.eval()


def read_tensors(path: str | Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read tensors and metadata of :func:`save_branch`; those of other programs have no metadata.

    Raises:
        InputError: If the file cannot be read or is damaged.
    """
    try:
        with safetensors.safe_open(path, "pt") as file:
            statement = strict_json.parse((file.metadata() or {}).get("slgaussian", "{}"))
            if not isinstance(statement, dict):
                raise ValueError("its note is no table")
            return {name: file.get_tensor(name) for name in file.keys()}, statement  # noqa: SIM118
    except Exception as error:  # a damaged file raises almost anything
        raise InputError(
            f"weights {path}: cannot be read ({error}); expected a safetensors file that "
            "`slgaussian train` wrote"
        ) from None
