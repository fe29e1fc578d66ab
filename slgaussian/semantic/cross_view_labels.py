"""Matches between pixels of different views by nearest Gaussians. Not in the paper.

The paper's branch sees one label image at a time. A label that is wrong in one view is mostly right
in another, and nearby Gaussians of other views give the corresponding pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slgaussian.gaussians import Gaussians
from slgaussian.kernels.threads import allotted

REACH = 6.0
"""Largest distance of a match, in standard deviations of the pixel's Gaussian along its longest
axis: two predictions of one surface are rarely nearer than 1, the next object is mostly farther."""


@dataclass(frozen=True, eq=False)
class CrossViewLabels:
    """The match of each context pixel: the nearest pixel of another view in 3D.

    Attributes
    ----------
    pixels : int64 [V, H, W]
        Flat index of the matching context pixel.
    near : float32 [V, H, W]
        1 at distance 0, falling linearly to 0 at :data:`REACH`; 0 without a match.
    """

    pixels: np.ndarray
    near: np.ndarray

    def fill(self, labels: np.ndarray) -> np.ndarray:
        """Return labels int32 [V, H, W] with unlabelled pixels filled from their matches."""
        return np.where((labels == 0) & (self.near > 0), labels.ravel()[self.pixels], labels)

    def images(self, images: np.ndarray) -> np.ndarray:
        """Gather the matches' values of code images [V, H, W, C]: float32 [V, H, W, C + 2].

        The last two channels are ``near``, and 1 where the match shows another object, 0 elsewhere.
        """
        matched = images.reshape(-1, images.shape[-1])[self.pixels]
        matched[self.near == 0] = 0
        labelled = (images[..., -1] > 0) & (matched[..., -1] > 0)
        differ = labelled & (matched != images).any(-1)
        return np.concatenate(
            [matched, self.near[..., None], differ[..., None]], -1, dtype=np.float32
        )


def match_across_views(gaussians: Gaussians, shape: tuple[int, int, int]) -> CrossViewLabels:
    """Match each pixel of V views of H x W (``shape``) to another view, by geometry alone.

    A pixel's position is that of its first Gaussian; a pixel without Gaussians has no match.
    """
    pixels, near = np.zeros(shape, np.int64), np.zeros(shape, np.float32)
    means = gaussians.to_arrays()["means"].astype(np.float64)
    widths = gaussians.to_arrays()["scales"].max(1, initial=0).astype(np.float64)
    owners, firsts = np.unique(gaussians.to_arrays()["source"], return_index=True)
    views = owners // (shape[1] * shape[2])
    for view in np.unique(views):
        inner, outer = np.flatnonzero(views == view), np.flatnonzero(views != view)
        if len(outer) == 0:
            continue
        reach = np.maximum(REACH * widths[firsts[inner]], 1e-12)
        tree = cKDTree(means[firsts[outer]])
        queries = means[firsts[inner]]
        distance, match = tree.query(queries, distance_upper_bound=reach.max(), workers=allotted())
        matched = match < len(outer)
        pixels.ravel()[owners[inner]] = owners[outer[np.where(matched, match, 0)]]
        near.ravel()[owners[inner]] = np.where(matched, np.maximum(1 - distance / reach, 0), 0)
    return CrossViewLabels(pixels, near)
