"""Liftings without a network: each Gaussian carries the object of its own source pixel."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.kernels import threads

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank


MAX_MATCH_DISTANCE = 6.0
"""Largest distance of a match, in standard deviations of the pixel's Gaussian along its longest
axis: two predictions of one surface are rarely nearer than 1, the next object is mostly farther."""


class HardIndex:
    """Copy the label of the source pixel (SegSplat, arXiv 2511.18386, lifts the same way)."""

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; the weight is 1 or, unlabelled, 0."""
        labels = label_maps.labels.ravel()[gaussians.to_arrays()["source"]]
        return gaussians.with_arrays(features=code_images(labels, bank.ids, bank.codes))


class Filled:
    """Fill unlabelled pixels from other views, then copy the label of the source pixel.

    See :func:`fill_from_other_views`. Not in the paper.
    """

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; the weight is 1 or, still unlabelled, 0."""
        filled = fill_from_other_views(label_maps.labels, gaussians)
        return HardIndex()(gaussians, replace(label_maps, labels=filled), bank)


def fill_from_other_views(labels: np.ndarray, gaussians: Gaussians) -> np.ndarray:
    """Copy labels int32 [V, H, W], and fill unlabelled pixels from the nearest of another view.

    A pixel's position is that of its first Gaussian; a pixel without Gaussians, or without one of
    another view within :data:`MAX_MATCH_DISTANCE`, stays as it is.
    """
    from scipy.spatial import cKDTree  # queries must not wait for its import

    filled = labels.copy()
    arrays = gaussians.to_arrays()
    means = arrays["means"].astype(np.float64)
    widths = arrays["scales"].max(1, initial=0).astype(np.float64)
    owners, firsts = np.unique(arrays["source"], return_index=True)
    views = owners // labels[0].size
    unlabelled = labels.ravel()[owners] == 0
    for view in np.unique(views[unlabelled]):
        inner, outer = np.flatnonzero((views == view) & unlabelled), np.flatnonzero(views != view)
        if len(outer) == 0:
            continue
        reach = np.maximum(MAX_MATCH_DISTANCE * widths[firsts[inner]], 1e-12)
        tree, queries = cKDTree(means[firsts[outer]]), means[firsts[inner]]
        distance, match = tree.query(
            queries, distance_upper_bound=reach.max(), workers=threads.pool.size
        )
        matched = distance < reach
        filled.ravel()[owners[inner[matched]]] = labels.ravel()[owners[outer[match[matched]]]]
    return filled


def code_images(labels: np.ndarray, ids: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Compute the code images M_i of the paper (section 3.1), with an additional weight channel.

    The last channel is 1 where the pixel has an object, else 0; the others are its code. Without
    it, as in the paper, a pixel without an object looks as one whose code is (0, 0, 0).

    Args:
        labels: int32 [...]. Object ids; 0 and ids that are not in ``ids`` mean no object.
        ids: int32 [N]. Positive and ascending.
        codes: float32 [N, D]

    Returns:
        float32 [..., D + 1]
    """
    # Indexed by row, not by id: ids of other programs may be in the millions.
    table = np.zeros((len(ids) + 1, codes.shape[1] + 1), np.float32)
    table[1:, :-1] = codes
    table[1:, -1] = 1
    rows = np.searchsorted(ids, labels)
    in_bank = np.append(ids, 0)[rows] == labels
    return table[np.where(in_bank & (labels > 0), rows + 1, 0)]
