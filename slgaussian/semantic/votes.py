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
    """Give each Gaussian the object that :func:`label_gaussians` finds.

    Returns:
        The Gaussians with features as in :class:`slgaussian.semantic.Lifting`, the weight being the
        winner's share.
    """
    labels, shares = label_gaussians(gaussians, label_maps.labels, cameras)
    features = code_images(labels, bank.ids, bank.codes)
    return gaussians.with_arrays(features=features * shares[:, None])


def label_gaussians(
    gaussians: Gaussians, labels: np.ndarray, cameras: Sequence[Camera]
) -> tuple[np.ndarray, np.ndarray]:
    """Find the label of each Gaussian: of its pixel, or of those with most of its blending weight.

    Args:
        labels: int32 [V, H, W]. 0 is none, which only wins where there is no other.
        cameras: Of the views of ``labels``.

    Returns:
        int32 [N] and float32 [N]: The label, and its share of the weight in labelled pixels; 0 and
            0 where no view shows the Gaussian in a labelled pixel.
    """
    if gaussians.pixelwise:
        pixel_labels = labels.ravel()[gaussians.to_arrays()["source"]]
        return pixel_labels, (pixel_labels > 0).astype(np.float32)
    ids = np.unique(np.append(labels, 0))
    rows = np.searchsorted(ids, labels).astype(np.int32)
    winners, shares = elect(sum_label_weights(gaussians, [*rows], cameras, len(ids)))
    return ids[winners].astype(np.int32), shares


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
