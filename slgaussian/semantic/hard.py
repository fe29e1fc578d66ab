"""The control without a network: each Gaussian carries the object of its own source pixel."""

from dataclasses import replace

import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank


class HardIndex:
    """Copy the label of the source pixel (SegSplat, arXiv 2511.18386, lifts the same way)."""

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; the weight is 1 or, unlabelled, 0."""
        count, dimension = int(label_maps.labels.max(initial=0)) + 1, bank.dimension
        table = np.zeros((count, dimension + 1), np.float32)
        table[bank.ids, :dimension] = bank.codes
        table[bank.ids, dimension] = 1 if dimension else np.arange(1, len(bank) + 1)
        features = table[label_maps.labels.ravel()[gaussians.source.numpy()]]
        return replace(gaussians, features=torch.from_numpy(features))
