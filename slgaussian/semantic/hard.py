"""The control without a network: each Gaussian carries the object of its own source pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank


class HardIndex:
    """Copy the label of the source pixel (SegSplat, arXiv 2511.18386, lifts the same way)."""

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; the weight is 1 or, unlabelled, 0."""
        from slgaussian.semantic.code_images import code_images

        labels = label_maps.labels.ravel()[gaussians.to_arrays()["source"]]
        features = code_images(labels, bank.ids, bank.codes)
        if not bank.dimension:
            # Without codes the weight says which row of the bank it is, from 1.
            rows = np.searchsorted(bank.ids, labels) + 1
            features *= rows[:, None].astype(np.float32)
        return gaussians.with_arrays(features=features)
