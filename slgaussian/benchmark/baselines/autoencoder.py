"""Per-scene autoencoder as in LangSplat: from C dimensions to three and back.

Reimplemented from the architecture of the published code (arXiv 2312.16084): the encoder has linear
layers C-256-128-64-32-3 with batch normalisation and ReLU, and unit-length codes; the decoder has
3-16-32-64-128-256-256-C with ReLU, and unit-length outputs; the loss is the squared error plus
0.001 (1 - cosine), minimised by Adam. Two differences: layers wider than C are left out, and the
vectors, some dozens from two photographs instead of hundreds of thousands, form one batch with a
fixed number of steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from slgaussian.errors import InputError
from slgaussian.kernels.threads import LARGE_THREADS, fixed

DOWN, UP = (256, 128, 64, 32), (16, 32, 64, 128, 256, 256)

RATE, COSINE = 2e-3, 0.001
"""Learning rate of Adam, and weight of (1 - cosine) relative to the squared error."""

BLOCK = 8192
"""Number of codes decoded at a time."""


@dataclass(frozen=True, eq=False)
class Autoencoder:
    """A trained autoencoder, see :func:`train_autoencoder`."""

    down: nn.Sequential
    up: nn.Sequential

    def encode(self, vectors: np.ndarray) -> np.ndarray:
        """Return codes float32 [M, 3] of length 1 of unit vectors float32 [M, C]."""
        with torch.inference_mode(), fixed(1):
            return F.normalize(self.down(torch.from_numpy(vectors)), dim=1).numpy()

    def decode(self, codes: np.ndarray) -> np.ndarray:
        """Return unit vectors float32 [P, C] of codes float32 [P, 3] of any length."""
        with torch.inference_mode(), fixed(LARGE_THREADS):
            blocks = torch.from_numpy(np.ascontiguousarray(codes)).split(BLOCK)
            return torch.cat([F.normalize(self.up(block), dim=1) for block in blocks]).numpy()


def train_autoencoder(vectors: np.ndarray, seed: int, steps: int = 1000) -> Autoencoder:
    """Fit an autoencoder to unit vectors float32 [M, C], M >= 2; deterministic, on one thread.

    ``seed`` determines the initial weights; each of ``steps`` uses all vectors. Raises InputError
    if there are fewer than two.
    """
    if len(vectors) < 2:
        raise InputError(f"autoencoder: found {len(vectors)} vectors, expected at least 2")
    width = vectors.shape[1]
    with torch.random.fork_rng(devices=[]), fixed(1):
        torch.manual_seed(seed % 2**63)
        down = _layers(width, [n for n in DOWN if n <= width], 3, normalised=True)
        up = _layers(3, [n for n in UP if n <= width], width, normalised=False)
        optimiser = torch.optim.Adam([*down.parameters(), *up.parameters()], lr=RATE)
        wanted = torch.from_numpy(vectors)
        for _ in range(steps):
            decoded = F.normalize(up(F.normalize(down(wanted), dim=1)), dim=1)
            similarity = F.cosine_similarity(decoded, wanted, dim=1).mean()
            loss = F.mse_loss(decoded, wanted) + COSINE * (1 - similarity)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    return Autoencoder(down.eval(), up.eval())


def _layers(start: int, hidden: list[int], end: int, normalised: bool) -> nn.Sequential:
    layers: list[nn.Module] = []
    for number, (a, b) in enumerate(pairwise([start, *hidden, end])):
        if number:
            layers += [nn.BatchNorm1d(a), nn.ReLU()] if normalised else [nn.ReLU()]
        layers.append(nn.Linear(a, b))
    return nn.Sequential(*layers)
