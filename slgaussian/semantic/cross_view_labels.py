"""Labels of unlabelled pixels from other views, by nearest Gaussians. Not in the paper."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import allotted

REACH = 6.0
"""Largest distance of a match, in standard deviations of the pixel's Gaussian along its longest
axis: two predictions of one surface are rarely nearer than 1, the next object is mostly farther."""


def fill_from_other_views(labels: np.ndarray, gaussians: Gaussians) -> np.ndarray:
    """Copy labels int32 [V, H, W], and fill unlabelled pixels from the nearest of another view.

    A pixel's position is that of its first Gaussian; a pixel without Gaussians, or without one of
    another view within :data:`REACH`, stays as it is.
    """
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
        reach = np.maximum(REACH * widths[firsts[inner]], 1e-12)
        tree, queries = cKDTree(means[firsts[outer]]), means[firsts[inner]]
        distance, match = tree.query(queries, distance_upper_bound=reach.max(), workers=allotted())
        matched = distance < reach
        filled.ravel()[owners[inner[matched]]] = labels.ravel()[owners[outer[match[matched]]]]
    return filled
