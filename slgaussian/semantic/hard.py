"""Liftings without a network: each Gaussian carries the object of its own source pixel."""

from __future__ import annotations

from dataclasses import replace
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
        labels = label_maps.labels.ravel()[gaussians.to_arrays()["source"]]
        features = code_images(labels, bank.ids, bank.codes)
        if not bank.dimension:
            # Without codes the weight says which row of the bank it is, from 1.
            rows = np.searchsorted(bank.ids, labels) + 1
            features *= rows[:, None].astype(np.float32)
        return gaussians.with_arrays(features=features)


class Filled:
    """Copy the label of the source pixel, after pixels without an object took one.

    Theirs is that of the nearest Gaussian of another view, if one is within reach
    (:mod:`slgaussian.semantic.cross_view_labels`). A pixel that has an object keeps it. Beyond the
    paper.
    """

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; the weight is 1 or, still unlabelled, 0."""
        from slgaussian.semantic.cross_view_labels import match_across_views

        matches = match_across_views(gaussians, label_maps.labels.shape)
        filled = replace(label_maps, labels=matches.fill(label_maps.labels))
        return HardIndex()(gaussians, filled, bank)


def code_images(labels: np.ndarray, ids: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Look up the label images M_i of the paper (section 3.1), with a weight beside each code.

    A pixel carries the code of its object times the weight, and the weight.

    The paper's images have the three numbers alone, and no way to tell a pixel without an object
    from one whose code is (0, 0, 0).

    Parameters
    ----------
    labels : int32 [...]
        Object ids; 0, and what is not among ``ids``, has no object.
    ids : int32 [N]
        Positive and ascending.
    codes : float32 [N, D]

    Returns
    -------
    float32 [..., D + 1]
        The weight is 1, or 0 where there is no object.
    """
    # Ids made elsewhere may be in the millions, too many for a table of all below the largest.
    table = np.zeros((len(ids) + 1, codes.shape[1] + 1), np.float32)
    table[1:, :-1] = codes
    table[1:, -1] = 1
    rows = np.searchsorted(ids, labels)
    in_bank = np.append(ids, 0)[rows] == labels
    return table[np.where(in_bank & (labels > 0), rows + 1, 0)]
