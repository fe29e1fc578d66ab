"""What the other views say about each pixel of a view, found in space. Beyond the paper.

The paper's branch looks at one label image at a time. What is wrong in one view is mostly right in
another, and the Gaussians say where: those of other views that lie next to one's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from slgaussian.gaussians import Gaussians

NEAREST = 4
"""Gaussians of other views that are asked."""

REACH = 6.0
"""How far they may be, in standard deviations of one's own Gaussian along its longest axis: two
predictions of one surface are rarely nearer than one, and the next object is mostly farther."""


@dataclass(frozen=True, eq=False)
class Others:
    """For each pixel of the context views, pixels of other views at the same place.

    Attributes
    ----------
    pixels : int64 [V * H * W, K]
        Flat indices of context pixels, nearest first.
    near : float32 [V * H * W, K]
        From 1, at the same place, to 0, at the reach; 0 where there is none.
    """

    pixels: np.ndarray
    near: np.ndarray

    def images(self, images: np.ndarray) -> np.ndarray:
        """What the others carry, float32 [V, H, W, C + 1] of code images [V, H, W, C].

        The mean by nearness, times the nearness of the nearest, and that last: 0 means that no
        other view sees the place, and 1 that one does right there.
        """
        flat = images.reshape(-1, images.shape[-1])
        closest = self.near[:, :1]
        shares = self.near * (closest / np.maximum(self.near.sum(1, keepdims=True), 1e-6))
        mean = np.einsum("pk,pkc->pc", shares, flat[self.pixels])
        found = np.concatenate([mean, closest], 1)
        return found.reshape(*images.shape[:-1], -1).astype(np.float32, copy=False)


def find_others(gaussians: Gaussians, shape: tuple[int, int, int]) -> Others:
    """Look for them; ``shape`` is (V, H, W). It depends on the geometry alone.

    A pixel stands where its frontmost stored Gaussian is, the first one of it; without one it has
    no others.
    """
    count = int(np.prod(shape))
    source = gaussians.source.numpy()
    means = gaussians.means.numpy().astype(np.float64)
    widths = gaussians.scales.numpy().max(1).astype(np.float64)
    pixels, near = np.zeros((count, NEAREST), np.int64), np.zeros((count, NEAREST), np.float32)
    owners, firsts = np.unique(source, return_index=True)
    views = owners // (shape[1] * shape[2])
    for view in np.unique(views):
        mine, theirs = np.flatnonzero(views == view), np.flatnonzero(views != view)
        if len(theirs) == 0:
            continue
        tree = cKDTree(means[firsts[theirs]])
        far, which = tree.query(means[firsts[mine]], k=[*range(1, NEAREST + 1)])
        known = which < len(theirs)
        pixels[owners[mine]] = owners[theirs[np.where(known, which, 0)]]
        reach = np.maximum(REACH * widths[firsts[mine]], 1e-12)
        near[owners[mine]] = np.where(known, np.clip(1 - far / reach[:, None], 0, 1), 0)
    return Others(pixels, near)
