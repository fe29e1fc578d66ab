"""Matches of two grey images, for tests and benches."""

import numpy as np

from slgaussian.cameras.matches import LOWE_RATIO, match, sift


def sift_matches(ref: np.ndarray, src: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Match the SIFT features of two grey uint8 images, mutually (ratio 0.8).

    Returns:
        float64 [M, 2], float64 [M, 2]: Pixels in each image, pixel centres at +0.5.
    """
    features = sift(ref), sift(src)
    i, j, _ = match(*features, LOWE_RATIO)
    return features[0].points[i], features[1].points[j]
