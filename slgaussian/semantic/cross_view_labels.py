"""Labels of each pixel in the other views, found in space. Beyond the paper.

The paper's branch looks at one label image at a time. What is wrong in one view is mostly right in
another, and the Gaussians say where: those of other views that lie next to one's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import allotted

REACH = 6.0
"""How far they may be, in standard deviations of one's own Gaussian along its longest axis: two
predictions of one surface are rarely nearer than one, and the next object is mostly farther."""


@dataclass(frozen=True, eq=False)
class CrossViewLabels:
    """For each pixel of the context views, the pixel of another view at the same place.

    Attributes
    ----------
    pixels : int64 [V, H, W]
        Flat indices of context pixels.
    near : float32 [V, H, W]
        From 1, at the same place, to 0, at the reach; 0 where there is none.
    """

    pixels: np.ndarray
    near: np.ndarray

    def fill(self, labels: np.ndarray) -> np.ndarray:
        """Labels int32 [V, H, W] in which pixels without an object took that of their other."""
        return np.where((labels == 0) & (self.near > 0), labels.ravel()[self.pixels], labels)

    def images(self, images: np.ndarray) -> np.ndarray:
        """Gather what other views carry, float32 [V, H, W, C + 2] of code images [V, H, W, C].

        Then how near it is, and 1 where it is another object than one's own, 0 elsewhere.
        """
        carried = images.reshape(-1, images.shape[-1])[self.pixels]
        carried[self.near == 0] = 0
        labelled = (images[..., -1] > 0) & (carried[..., -1] > 0)
        differ = labelled & (carried != images).any(-1)
        return np.concatenate(
            [carried, self.near[..., None], differ[..., None]], -1, dtype=np.float32
        )


def match_across_views(gaussians: Gaussians, shape: tuple[int, int, int]) -> CrossViewLabels:
    """Find for each pixel of V views of H x W, ``shape``, its place in another, by geometry alone.

    A pixel stands where the first of its Gaussians is; without one it has no match.
    """
    pixels, near = np.zeros(shape, np.int64), np.zeros(shape, np.float32)
    means = gaussians.to_arrays()["means"].astype(np.float64)
    widths = gaussians.to_arrays()["scales"].max(1, initial=0).astype(np.float64)
    owners, firsts = np.unique(gaussians.to_arrays()["source"], return_index=True)
    views = owners // (shape[1] * shape[2])
    for view in np.unique(views):
        mine, theirs = np.flatnonzero(views == view), np.flatnonzero(views != view)
        if len(theirs) == 0:
            continue
        reach = np.maximum(REACH * widths[firsts[mine]], 1e-12)
        tree = cKDTree(means[firsts[theirs]])
        queries = means[firsts[mine]]
        far, which = tree.query(queries, distance_upper_bound=reach.max(), workers=allotted())
        matched = which < len(theirs)
        pixels.ravel()[owners[mine]] = owners[theirs[np.where(matched, which, 0)]]
        near.ravel()[owners[mine]] = np.where(matched, np.maximum(1 - far / reach, 0), 0)
    return CrossViewLabels(pixels, near)
