"""The Middlebury 2014 "Motorcycle" pair in scikit-image: a real posed pair without a download.

The calibration is from the docstring of ``skimage.data.stereo_motorcycle``: that of
https://vision.middlebury.edu/stereo/data/scenes2014/ divided by four. With d the disparity (left
column minus right column), f the focal length, b the baseline and doffs the difference between the
principal points, right minus left, a left pixel has depth Z = b f / (d + doffs): the right camera
is b to the right of the left one, so the right column is f (X - b) / Z + cx + doffs, the left
column f X / Z + cx, and their difference d = b f / Z - doffs.

The original calibration has pixel centres at integers. Pixel i covers [i, i + 1] here, and four
pixels were averaged into one, so column x of the original is at (x + 0.5) / 4 from the left edge:
the principal point increases by an eighth of a pixel. Focal length, doffs and disparities do not
depend on the origin.
"""

import numpy as np
import skimage.data

from slgaussian.scene import Camera, Scene, View

FOCAL = 994.978
PRINCIPAL = (311.193 + 0.125, 254.877 + 0.125)
DOFFS = 31.086
BASELINE = 0.193001
"""Metres, the unit of the scene."""


def read() -> Scene:
    """Read the pair as views "left" and "right", 500x741 pixels, rectified and in metres.

    The left camera is the origin of the world. The left view has the true depth, float32, 0 where
    the data set has none (about 7 % of the pixels); the right view has no ground truth.
    """
    height, width = 500, 741
    cameras = {}
    for name, x, cx in (("left", 0.0, PRINCIPAL[0]), ("right", BASELINE, PRINCIPAL[0] + DOFFS)):
        K = np.array([[FOCAL, 0, cx], [0, FOCAL, PRINCIPAL[1]], [0, 0, 1]])
        c2w = np.eye(4)
        c2w[0, 3] = x
        cameras[name] = Camera(K, c2w, width, height)

    def view(name: str) -> View:
        left, right, disparity = skimage.data.stereo_motorcycle()
        if name == "left":
            return View(name, cameras[name], left, depth_from_disparity(disparity))
        return View(name, cameras[name], right)

    return Scene("motorcycle", cameras, view)


def depth_from_disparity(disparity: np.ndarray) -> np.ndarray:
    """Compute depth in metres, float32, of left disparities in pixels; 0 where not finite."""
    finite = np.isfinite(disparity)
    return np.where(finite, BASELINE * FOCAL / (np.where(finite, disparity, 0) + DOFFS), 0).astype(
        np.float32
    )
