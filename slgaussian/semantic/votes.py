"""Lifting to Gaussians that are of no pixel: the views vote, by blending weight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from slgaussian.kernels.jit import kernel
from slgaussian.rasterize.label_weights import sum_label_weights
from slgaussian.semantic.hard import code_images

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank
    from slgaussian.scene import Camera


def vote(
    gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank, cameras: Sequence[Camera]
) -> Gaussians:
    """Give each Gaussian the object in whose pixels most of its blending weight is.

    Args:
        cameras: Of the views of ``label_maps``, in their order.

    Returns:
        The Gaussians with features as in :class:`slgaussian.semantic.Lifting`. The weight is the
        share of the winner in the labelled pixels; 0 where no view shows the Gaussian.
    """
    ids = np.concatenate([[0], bank.ids])
    rows = np.searchsorted(ids, label_maps.labels)
    rows[ids[np.minimum(rows, len(ids) - 1)] != label_maps.labels] = 0
    weights = sum_label_weights(gaussians, rows.astype(np.int32), cameras, len(ids))
    winners, margins = elect(weights)
    features = code_images(ids[winners].astype(np.int32), bank.ids, bank.codes)
    return gaussians.with_arrays(features=features * margins[:, None])


def elect(weights: sparse.csr_array) -> tuple[np.ndarray, np.ndarray]:
    """Return the column above 0 with the largest weight of each row, and its share of them.

    int32 [N] and float32 [N], 0 and 0 for rows without weight above column 0; of equal weights the
    lowest column wins.
    """
    winners = np.zeros(weights.shape[0], np.int32)
    shares = np.zeros(weights.shape[0], np.float32)
    weights.sort_indices()
    _elect(weights.indptr, weights.indices, weights.data, winners, shares)
    return winners, shares


@kernel
def _elect(starts, columns, weights, winners, shares):
    for row in range(len(winners)):
        best = total = 0.0
        for k in range(starts[row], starts[row + 1]):
            if columns[k] > 0:
                total += weights[k]
                if weights[k] > best:
                    best, winners[row] = weights[k], columns[k]
        if total > 0:
            shares[row] = best / total
