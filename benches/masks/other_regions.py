"""Partitions of a photograph by scikit-image and OpenCV, next to which ours are measured.

Each is a function from a photograph to labels int [H, W] from 0, at several settings: from some 20
to some 200 regions of a photograph.
"""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from skimage.measure import label as connected_pieces
from skimage.segmentation import felzenszwalb, slic

Partition = Callable[[np.ndarray], np.ndarray]


def opencv_graph(image: np.ndarray, k: float, least: int) -> np.ndarray:
    """Felzenszwalb and Huttenlocher's as OpenCV has it."""
    work = cv2.ximgproc.segmentation.createGraphSegmentation(0.8, k, least)
    return work.processImage(image[..., ::-1])


def opencv_superpixels(image: np.ndarray, side: int) -> np.ndarray:
    """Linear spectral clustering (Li and Chen, CVPR 2015)."""
    work = cv2.ximgproc.createSuperpixelLSC(cv2.cvtColor(image, cv2.COLOR_RGB2LAB), side, 0.075)
    work.iterate(10)
    work.enforceLabelConnectivity(25)
    return work.getLabels()


def opencv_mean_shift(image: np.ndarray, colors: float, least: int) -> np.ndarray:
    """Mean shift, pieces of one colour of it, and a watershed from those that are large."""
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    calm = cv2.pyrMeanShiftFiltering(lab, 10, colors)
    steps = (calm // max(int(colors / 2), 1)).astype(np.int32)
    pieces = connected_pieces(steps @ np.array([65536, 256, 1]) + 1, connectivity=1)
    large = np.bincount(pieces.ravel()) >= least
    seeds = np.where(large[pieces], pieces, 0).astype(np.int32)
    if not large[1:].any():
        return np.zeros(image.shape[:2], np.int32)
    found = cv2.watershed(calm, seeds)
    # Lines of the watershed are one pixel wide: each joins the region beside or above it.
    _, nearest = cv2.distanceTransformWithLabels(
        (found <= 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    names = np.zeros(int(nearest.max()) + 1, np.int32)
    names[nearest[found > 0]] = found[found > 0]
    return np.unique(names[nearest], return_inverse=True)[1].reshape(found.shape)


def skimage_graph(image: np.ndarray, scale: float, least: int) -> np.ndarray:
    return felzenszwalb(image, scale=scale, sigma=0.8, min_size=least)


def skimage_slic(image: np.ndarray, pieces: int, compact: float) -> np.ndarray:
    return slic(image, n_segments=pieces, compactness=compact, sigma=1, start_label=0)


METHODS: dict[str, dict[str, Partition]] = {
    "scikit-image SLIC": {
        f"{pieces} pieces, compactness {compact}": partial(
            skimage_slic, pieces=pieces, compact=compact
        )
        for pieces in (25, 50, 100, 200)
        for compact in (5, 15)
    },
    "scikit-image Felzenszwalb": {
        f"scale {scale}, least {least}": partial(skimage_graph, scale=scale, least=least)
        for scale in (100, 300, 1000)
        for least in (200, 800)
    },
    "OpenCV graph": {
        f"k {k}, least {least}": partial(opencv_graph, k=k, least=least)
        for k in (100, 300, 1000)
        for least in (200, 800)
    },
    "OpenCV LSC": {
        f"side {side}": partial(opencv_superpixels, side=side) for side in (100, 70, 50, 35)
    },
    "OpenCV mean shift": {
        f"colours {colors}, least {least}": partial(opencv_mean_shift, colors=colors, least=least)
        for colors in (10, 20, 30)
        for least in (200, 800)
    },
}
