"""LangSplat-like: autoencoder codes on the Gaussians, decoded and scored per pixel.

LangSplat (arXiv 2312.16084) optimises Gaussians for the scene, then a code per Gaussian, for each
of three mask granularities. Here there is one granularity, the masks of the other methods, and the
Gaussians are predicted, each with the code of its source pixel: the row of the paper's ablation
with the feed-forward model alone and, with associated masks, the row above the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slgaussian.benchmark.baselines.autoencoder import Autoencoder, train_autoencoder
from slgaussian.benchmark.baselines.dense import DenseView
from slgaussian.benchmark.baselines.drawn import draw_picture, draw_vectors, reduced
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.kernels.seeding import seed_for
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE


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
        """Train the autoencoder of a scene, and assign a code to each Gaussian."""
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
        gaussians = self.inputs.gaussians
        picture = draw_picture(gaussians, camera)
        small = reduced(camera, self.inputs.bank.features.shape[2])
        drawn = draw_vectors(gaussians, small, [lambda at, a, b: self.carried[at, a:b]], 4)[0]
        codes, weight = drawn[..., :3], drawn[..., 3:]
        codes = np.divide(codes, weight, out=np.zeros_like(codes), where=weight > 0)
        vectors = self.network.decode(codes.reshape(-1, 3)).reshape(1, *codes.shape[:2], -1)
        # If most of a pixel's weight has no mask, its code is not valid.
        full_size = camera.width, camera.height
        visible = cv2.resize(drawn[..., 3], full_size, interpolation=cv2.INTER_LINEAR) >= VISIBLE
        return DenseView(picture.rgb, picture.depth, self.inputs.reader, visible, vectors)
