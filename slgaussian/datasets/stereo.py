"""The Middlebury 2014 "Motorcycle" pair in scikit-image: a real posed pair without a download.

The calibration is from the docstring of ``skimage.data.stereo_motorcycle``: that of
https://vision.middlebury.edu/stereo/data/scenes2014/ divided by four. With d the disparity (left
column minus right column), f the focal length, b the baseline and doffs the difference of the
principal points, right minus left, a left pixel has depth Z = b f / (d + doffs).

The original has pixel centres at integers, here they are at +0.5, and four pixels were averaged
into one, so column x of the original is at (x + 0.5) / 4: the principal point increases by an
eighth of a pixel.
"""

import numpy as np
import skimage.data

from slgaussian.scene import Camera, Scene, View

FOCAL = 994.978
PRINCIPAL = (311.193 + 0.125, 254.877 + 0.125)
DOFFS = 31.086
BASELINE = 0.193001  # metres, the unit of the scene


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
        if name == "right":
            return View(name, cameras[name], right)
        depth = BASELINE * FOCAL / (disparity + DOFFS)  # 0 where the disparity is infinite
        return View(name, cameras[name], left, depth.astype(np.float32))

    return Scene("motorcycle", cameras, view)
