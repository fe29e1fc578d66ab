"""The semantic branch: network from code images to Gaussian features (paper, section 3.1).

There are two networks: ``paper`` is that of the paper (:class:`PaperBranch`); ``several`` also
gets the code that other views have at each pixel (:class:`SeveralViewsBranch`) and is not in the
paper.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

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
from slgaussian.semantic.cross_view_labels import CrossViewLabels, match_across_views
from slgaussian.semantic.hard import code_images
from slgaussian.semantic.versions import find_weights

DIMENSION = 3
"""Dimension of an ID code, as in the paper."""

CODE_CHANNELS = DIMENSION + 1
"""Channels of a code image and of a feature: the code times the weight, and the weight."""


Name = Literal["several", "paper"]
"""The networks."""


@dataclass(frozen=True)
class Architecture:
    """Layers of a branch; weights of one architecture do not fit another.

    Attributes
    ----------
    name : str
    widths : tuple of int
        Channels at full resolution, then after each residual block, at 1/2, 1/4 ... of it.
    hidden : int
        Width of the MLP's one hidden layer.
    """

    name: Name = "several"
    widths: tuple[int, ...] = (8, 16, 24, 32)
    hidden: int = 32

    @property
    def cross_view(self) -> bool:
        """True if other views are an input (:mod:`slgaussian.semantic.cross_view_labels`)."""
        return self.name == "several"

    @property
    def channels(self) -> int:
        """Channels of the input: the view's code image and, with ``cross_view``, other views'."""
        return 2 * CODE_CHANNELS + 2 if self.cross_view else CODE_CHANNELS


class Branch(nn.Module):
    """A network from input images to features, both at full resolution; see :func:`make_branch`.

    ``forward`` takes float [V, H, W, C] of any size, with C = :attr:`Architecture.channels`; the
    first 4 channels are the view's own code image. It returns float [V, H, W, 4]: code times
    weight, and the weight, neither clamped to [0, 1].
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture


class PaperBranch(Branch):
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
        super().__init__(architecture)
        widths, hidden = architecture.widths, architecture.hidden
        self.stem = nn.Conv2d(DIMENSION, widths[0], 3, padding=1)
        self.down = nn.Sequential(*(_HalvingBlock(*pair) for pair in pairwise(widths)))
        self.up = nn.Conv2d(widths[-1], DIMENSION, 1)
        self.first = nn.Conv2d(DIMENSION, hidden, 1)
        self.last = nn.Conv2d(hidden, DIMENSION, 1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """See :class:`Branch`."""
        codes = images[..., :DIMENSION].permute(0, 3, 1, 2)
        coarse = self.up(self.down(F.relu(self.stem(codes))))
        mixed = codes + F.interpolate(coarse, codes.shape[-2:], mode="bilinear")
        features = self.last(F.relu(self.first(mixed))).permute(0, 2, 3, 1)
        return torch.cat([features, torch.ones_like(features[..., :1])], -1)


class SeveralViewsBranch(Branch):
    """A residual network that also gets the codes of other views. Not in the paper.

    Its input is the code image, in which pixels without an object have the object of their match in
    another view, and the code of that match, which the network may mix in. Convolutions have
    lateral connections at every level, the MLP has a skip connection, and the last layers are
    initialised to zero: untrained, it equals :class:`slgaussian.semantic.hard.Filled`.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__(architecture)
        channels, hidden = architecture.channels, architecture.hidden
        self.convolutions = _Convolutions(channels, architecture.widths)
        self.first = nn.Conv2d(channels, hidden, 1)
        self.last = _zeroed(nn.Conv2d(hidden, CODE_CHANNELS + 2, 1))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """See :class:`Branch`."""
        stacked = images.permute(0, 3, 1, 2)
        mixed = stacked + self.convolutions(stacked)
        change = self.last(F.relu(self.first(mixed)))
        # Explicit products: copying a random code is slow to learn for sums of ReLUs.
        n = CODE_CHANNELS
        own_factor, other_factor = change[:, n : n + 1], change[:, n + 1 :]
        features = mixed[:, :n] + change[:, :n]
        features = features + own_factor * stacked[:, :n] + other_factor * stacked[:, n : 2 * n]
        return features.permute(0, 2, 3, 1)


def make_branch(architecture: Architecture, seed: int = 0) -> Branch:
    """Make an untrained network; the same seed gives the same weights."""
    network = PaperBranch if architecture.name == "paper" else SeveralViewsBranch
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return network(architecture)


def _zeroed(convolution: nn.Conv2d) -> nn.Conv2d:
    """Set all parameters of the convolution to zero and return it."""
    for parameter in convolution.parameters():
        nn.init.zeros_(parameter)
    return convolution


class _Convolutions(nn.Module):
    def __init__(self, channels: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.stem = nn.Conv2d(channels, widths[0], 3, padding=1)
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList(_HalvingBlock(*pair) for pair in pairs)
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairs)
        self.head = _zeroed(nn.Conv2d(widths[0], channels, 1))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        levels = [F.relu(self.stem(images))]
        for block in self.down:
            levels.append(block(levels[-1]))
        fused = levels.pop()
        for lateral, finer in zip(reversed(self.up), reversed(levels), strict=True):
            fused = finer + F.interpolate(lateral(fused), finer.shape[-2:], mode="bilinear")
        change: torch.Tensor = self.head(fused)
        return change


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
        """See :class:`slgaussian.semantic.Lifting`; InputError if codes are not [N, 3]."""
        cross_view = self.branch.architecture.cross_view
        matches = match_across_views(gaussians, label_maps.labels.shape) if cross_view else None
        images = input_images(label_maps.labels, bank.ids, bank.codes, matches)
        with torch.no_grad(), inside(self.branch):
            features = features_of(self.branch, images, gaussians.source)
        return replace(gaussians, features=features)


def load_branch_lifting(weights: str | Path | None = None) -> BranchLifting:
    """Load the lifting from a file or folder of weights.

    Raises
    ------
    InputError
        If ``weights`` is None, or the weights are missing or damaged.
    """
    if weights is None:
        raise InputError(
            "lifting 'branch': no weights are given; train some with `slgaussian train` and "
            "give the file, as --set branch.weights=trained/branch.safetensors, or choose the "
            "lifting 'hard'"
        )
    return BranchLifting(load_branch(find_weights(weights)))


def input_images(
    labels: np.ndarray, ids: np.ndarray, codes: np.ndarray, matches: CrossViewLabels | None
) -> torch.Tensor:
    """Make the input images of a branch.

    Parameters
    ----------
    labels : int32 [V, H, W]
        Object ids of the context views.
    ids, codes : int32 [N], float32 [N, 3]
        The ID code of each object.
    matches : CrossViewLabels, optional
        Required by an architecture with ``cross_view``.

    Returns
    -------
    float32 [V, H, W, C]

    Raises
    ------
    InputError
        If codes are not three-dimensional.
    """
    if codes.shape[1] != DIMENSION:
        raise InputError(
            f"lifting 'branch': found codes of {codes.shape[1]} numbers, expected {DIMENSION}, "
            "which branches are trained for; choose such codes, or the lifting 'hard'"
        )
    if matches is None:
        return torch.from_numpy(code_images(labels, ids, codes))
    filled = code_images(matches.fill(labels), ids, codes)
    matched = matches.images(code_images(labels, ids, codes))
    return torch.from_numpy(np.concatenate([filled, matched], -1))


def features_of(branch: Branch, images: torch.Tensor, source: torch.Tensor) -> torch.Tensor:
    """Compute the feature of each Gaussian, float32 [N, 4]: that of its ``source`` pixel, int [N].

    The network runs on the device of its weights; the result is on the CPU.
    """
    images = images.to(next(branch.parameters()).device)
    return branch(images).cpu().flatten(0, 2).index_select(0, source)


def save_branch(branch: Branch, trained: Mapping[str, Any] | None = None) -> bytes:
    """Encode weights and architecture as a safetensors file, deterministically.

    ``trained`` is the provenance of the weights, as JSON data.
    """
    tensors = {name: t.detach().contiguous() for name, t in branch.state_dict().items()}
    metadata = {} if trained is None else {"trained": dict(trained)}
    return encode_tensors(tensors, {"architecture": asdict(branch.architecture), **metadata})


def load_branch(path: str | Path) -> Branch:
    """Read a file of :func:`save_branch`; the branch is in evaluation mode.

    Raises
    ------
    InputError
        If the file cannot be read, or is not a branch.
    """
    return branch_of(*read_tensors(path), path)


def branch_of(
    tensors: Mapping[str, torch.Tensor], statement: Mapping[str, Any], path: str | Path
) -> Branch:
    """Build the branch from its named tensors and metadata; see :func:`load_branch`."""
    try:
        values = {**statement["architecture"], "widths": tuple(statement["architecture"]["widths"])}
        if values.pop("others", True) is False:
            raise InputError(
                f"weights {path}: are of a network that saw one view and was called 'paper', which "
                "was not the paper's (it added to its input, and its loss left out unknown pixels) "
                "and is gone; train again with --architecture paper, or without for 'several'"
            )
        architecture = Architecture(**values)
    except (KeyError, TypeError):
        raise InputError(
            f"weights {path}: does not say which branch it is of, expected a file that "
            "`slgaussian train` wrote"
        ) from None
    try:
        if architecture.name not in get_args(Name):
            raise ValueError(f"no network is called {architecture.name!r}")
        with torch.device("meta"):
            branch = make_branch(architecture)
        branch.load_state_dict(dict(tensors), assign=True)
    except (RuntimeError, TypeError, ValueError, OverflowError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[-1].strip()[:200]
        raise InputError(
            f"weights {path}: tensors are not those of the architecture that it says it is of "
            f"({reason}); train again"
        ) from None
    return branch.eval()


def encode_tensors(tensors: Mapping[str, torch.Tensor], statement: Mapping[str, Any]) -> bytes:
    """Encode tensors as a safetensors file; ``statement`` is JSON data for its metadata."""
    # One entry only: safetensors writes several in an order that differs from run to run.
    note = {"slgaussian": json.dumps(statement, sort_keys=True)}
    return safetensors.torch.save(dict(sorted(tensors.items())), note)


def read_tensors(path: str | Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Inverse of :func:`encode_tensors`; the metadata of other programs' files is empty.

    Raises
    ------
    InputError
        If the file cannot be read or is damaged.
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
