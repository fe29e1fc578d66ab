"""LangSplat-like: autoencoder codes on the Gaussians, decoded and scored per pixel.

LangSplat (arXiv 2312.16084) optimises Gaussians for the scene, then a code per Gaussian, for each
of three mask granularities. Here there is one granularity, the masks of the other methods, and the
Gaussians are predicted, each with the code of its source pixel: the row of the paper's ablation
with the feed-forward model alone and, with associated masks, the row above the last.

The autoencoder of a scene has the published architecture: linear layers C-256-128-64-32-3 with
batch normalisation and ReLU, unit-length codes, then 3-16-32-64-128-256-256-C with ReLU and
unit-length outputs; the loss is the squared error plus 0.001 (1 - cosine), minimised by Adam. Two
differences: layers wider than C are left out, and the vectors, some dozens from two photographs
instead of hundreds of thousands, form one batch with a fixed number of steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from slgaussian.benchmark.baselines.dense import DenseView, draw_picture
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.errors import InputError
from slgaussian.kernels.seeding import seed_for
from slgaussian.kernels.threads import LARGE_NETWORK_THREADS, limit_threads
from slgaussian.labels import MIN_WEIGHT
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera

ENCODER_WIDTHS, DECODER_WIDTHS = (256, 128, 64, 32), (16, 32, 64, 128, 256, 256)

LEARNING_RATE, COSINE_WEIGHT = 2e-3, 0.001
"""Learning rate of Adam, and weight of (1 - cosine) relative to the squared error."""

DECODER_BATCH = 8192
"""Number of codes decoded at a time."""

MAX_ELEMENTS = 2**26
"""Largest number of elements of an image of vectors, 256 MB in float32; a larger one is rendered at
a half, a quarter ... of the resolution."""


@dataclass(frozen=True)
class LangSplatLike:
    """See the module.

    Attributes:
        association: Whether masks are associated across views. In both cases each view has its own
            vector of an object.
        steps: Optimisation steps of the autoencoder.
    """

    association: bool = False
    steps: int = 1000

    def __call__(self, inputs: Inputs) -> _Codes:
        """Train the autoencoder of a scene, and assign a code to each Gaussian.

        Raises:
            InputError: If the Gaussians are of no pixel.
        """
        if not inputs.gaussians.pixelwise:
            raise InputError(
                "LangSplat-like: needs a Gaussian for each pixel, and those of a splat that exists "
                "are of none; compare with another method"
            )
        labels = inputs.label_maps if self.association else inputs.own_labels
        bank = inputs.bank if self.association else inputs.own_bank
        seed = seed_for(inputs.seed, inputs.sample.content, "autoencoder")
        network = train_autoencoder(bank.features[bank.present], seed, self.steps)
        table = np.zeros((len(bank) + 1, bank.features.shape[1], 4), np.float32)
        table[1:, :, :3][bank.present] = network.encode(bank.features[bank.present])
        table[1:, :, 3] = bank.present
        rows = np.searchsorted(bank.ids, labels.labels) + 1
        rows[labels.labels == 0] = 0
        maps = np.stack([table[of_view, v] for v, of_view in enumerate(rows)])
        return _Codes(inputs, network, maps.reshape(-1, 4))


@dataclass(frozen=True, eq=False)
class _Codes:
    """Codes by ``source`` of the Gaussians; ``carried`` float32 [P, 4] is code and 1, or zeros."""

    inputs: Inputs
    network: Autoencoder
    carried: np.ndarray

    def render(self, camera: Camera) -> DenseView:
        gaussians, size = self.inputs.gaussians, np.array([camera.width, camera.height])
        picture = draw_picture(gaussians, camera)
        factor = 1
        while size.prod() * self.inputs.bank.features.shape[2] > MAX_ELEMENTS * factor**2:
            factor *= 2
        carried = torch.from_numpy(self.carried[gaussians.source.numpy()])
        small = camera.resize(*np.maximum(size // factor, 1).tolist())
        drawn = rasterize(gaussians, carried, small).values.float().numpy()
        codes, weight = drawn[..., :3], drawn[..., 3:]
        codes = np.divide(codes, weight, out=np.zeros_like(codes), where=weight > 0)
        vectors = self.network.decode(codes.reshape(-1, 3)).reshape(*codes.shape[:2], -1)
        # If most of a pixel's weight has no mask, its code is not valid.
        weight = cv2.resize(drawn[..., 3], size.tolist(), interpolation=cv2.INTER_LINEAR)
        visible = weight >= MIN_WEIGHT
        return DenseView(picture.rgb, picture.depth, self.inputs.reader, visible, vectors)


@dataclass(frozen=True, eq=False)
class Autoencoder:
    """A trained autoencoder, see :func:`train_autoencoder`."""

    down: nn.Sequential
    up: nn.Sequential

    def encode(self, vectors: np.ndarray) -> np.ndarray:
        """Return codes float32 [M, 3] of length 1 of unit vectors float32 [M, C]."""
        with torch.inference_mode(), limit_threads(1):
            return F.normalize(self.down(torch.from_numpy(vectors)), dim=1).numpy()

    def decode(self, codes: np.ndarray) -> np.ndarray:
        """Return unit vectors float32 [P, C] of codes float32 [P, 3] of any length."""
        with torch.inference_mode(), limit_threads(LARGE_NETWORK_THREADS):
            blocks = torch.from_numpy(np.ascontiguousarray(codes)).split(DECODER_BATCH)
            return torch.cat([F.normalize(self.up(block), dim=1) for block in blocks]).numpy()


def train_autoencoder(vectors: np.ndarray, seed: int, steps: int = 1000) -> Autoencoder:
    """Fit an autoencoder to unit vectors float32 [M, C], M >= 2; deterministic, on one thread.

    ``seed`` determines the initial weights; each of ``steps`` uses all vectors. Raises InputError
    if there are fewer than two.
    """
    if len(vectors) < 2:
        raise InputError(f"autoencoder: found {len(vectors)} vectors, expected at least 2")
    width = vectors.shape[1]
    with torch.random.fork_rng(devices=[]), limit_threads(1):
        torch.manual_seed(seed % 2**63)
        down = _layers(width, [n for n in ENCODER_WIDTHS if n <= width], 3, normalised=True)
        up = _layers(3, [n for n in DECODER_WIDTHS if n <= width], width, normalised=False)
        optimiser = torch.optim.Adam([*down.parameters(), *up.parameters()], lr=LEARNING_RATE)
        targets = torch.from_numpy(vectors)
        for _ in range(steps):
            decoded = F.normalize(up(F.normalize(down(targets), dim=1)), dim=1)
            similarity = F.cosine_similarity(decoded, targets, dim=1).mean()
            loss = F.mse_loss(decoded, targets) + COSINE_WEIGHT * (1 - similarity)
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
