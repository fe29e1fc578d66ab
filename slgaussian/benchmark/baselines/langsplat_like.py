"""LangSplat-like: an autoencoder's codes on the Gaussians, decoded and scored pixel by pixel.

LangSplat (arXiv 2312.16084) optimises Gaussians for the scene, then a code a Gaussian, for each of
three granularities of masks. Here the Gaussians are the predicted ones, each has the code of its
source pixel, and there is one granularity: the masks that the other methods have too. In the
paper's ablation that is the row with the feed-forward model alone; with masks that agree across
views it is the row above the last; and with Gaussians and codes that are optimised for the
photographs, by gradients through the rasteriser, the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from slgaussian.benchmark.baselines.autoencoder import Autoencoder, train_autoencoder
from slgaussian.benchmark.baselines.dense import DenseView
from slgaussian.benchmark.baselines.drawn import draw_picture, draw_vectors, reduced
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.baselines.optimised import fit_vectors, optimise, small
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.seeding import seed_for
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE


@dataclass(frozen=True)
class LangSplatLike:
    """See the module.

    Attributes
    ----------
    association : bool
        Whether masks are those that agree across views, or each view's own. Each view keeps its own
        vector of an object in either case.
    steps : int
        Of the autoencoder's training.
    fit : int
        Steps in which Gaussians, and then codes, are optimised for the photographs; with 0 they are
        the predicted ones, each with the code of its pixel.

    Raises
    ------
    InputError
        If ``steps`` is below 1, or ``fit`` below 0.
    """

    association: bool = False
    steps: int = 1000
    fit: int = 0

    def __post_init__(self) -> None:
        for name, least in (("steps", 1), ("fit", 0)):
            if (value := getattr(self, name)) < least:
                raise InputError(f"langsplat-like {name}: found {value}, expected at least {least}")

    def __call__(self, inputs: Inputs) -> _Codes:
        """Train the autoencoder of a scene, and give each Gaussian its code."""
        labels = inputs.label_maps if self.association else inputs.own_labels
        bank = inputs.bank if self.association else inputs.own_bank
        seed = seed_for(inputs.seed, inputs.sample.content, "autoencoder")
        network = train_autoencoder(bank.features[bank.present], seed, self.steps)
        table = np.zeros((len(bank) + 1, bank.features.shape[1], 4), np.float32)
        table[1:, :, :3][bank.present] = network.encode(bank.features[bank.present])
        table[1:, :, 3] = bank.present
        rows = np.searchsorted(bank.ids, labels.labels) + 1
        rows[labels.labels == 0] = 0
        if not self.fit:
            carried = [table[of_view, v].reshape(-1, 4) for v, of_view in enumerate(rows)]
            return _Codes(inputs, inputs.gaussians, network, np.concatenate(carried))
        context = inputs.sample.context
        gaussians, _ = optimise(context, self.fit)
        seen = [
            small(replace(view, instances=own)) for view, own in zip(context, rows, strict=True)
        ]
        images = [table[view.instances, v] for v, view in enumerate(seen)]
        fitted, _ = fit_vectors(gaussians, [view.camera for view in seen], images, self.fit)
        return _Codes(inputs, gaussians, network, fitted)


@dataclass(frozen=True, eq=False)
class _Codes:
    """``carried`` float32 [S, 4], by the sources of the Gaussians: a code and 1, or zeros."""

    inputs: Inputs
    gaussians: Gaussians
    network: Autoencoder
    carried: np.ndarray

    def render(self, camera: Camera) -> DenseView:
        gaussians = self.gaussians
        picture = draw_picture(gaussians, camera)
        small = reduced(camera, self.inputs.bank.features.shape[2])
        drawn = np.empty((small.height, small.width, 4), np.float32)
        draw_vectors(gaussians, small, self._at, drawn)
        codes, weight = drawn[..., :3], drawn[..., 3:]
        codes = np.divide(codes, weight, out=np.zeros_like(codes), where=weight > 0)
        vectors = self.network.decode(codes.reshape(-1, 3)).reshape(1, *codes.shape[:2], -1)
        # Where most is without a mask, no code says anything.
        whole = camera.width, camera.height
        seen = cv2.resize(drawn[..., 3], whole, interpolation=cv2.INTER_LINEAR) >= VISIBLE
        return DenseView(picture.rgb, picture.depth, self.inputs.reader, seen, vectors)

    def _at(self, pixels: np.ndarray, start: int, stop: int) -> np.ndarray:
        return self.carried[pixels, start:stop]
