"""The stereo pair of scikit-image: depth against its disparity, cameras against Middlebury's."""

import numpy as np
import skimage.data

from slgaussian.datasets import stereo


def test_depth_projects_left_pixels_to_the_right_by_their_disparity():
    _, _, disparity = skimage.data.stereo_motorcycle()
    scene = stereo.read()
    left = scene.read("left")
    valid = np.isfinite(disparity)
    pixels, z = scene.cameras["right"].project(left.camera.unproject(left.depth))
    v, u = np.indices(disparity.shape) + 0.5
    # Depth is stored as float32: 3e-7 relative of up to 91 pixels.
    assert np.abs(u - pixels[..., 0] - disparity)[valid].max() < 1e-4
    assert np.abs(v - pixels[..., 1])[valid].max() < 1e-9
    assert np.abs(z - left.depth)[valid].max() < 1e-9
    assert (left.depth[~valid] == 0).all() and (left.depth[valid] > 0).all()


def test_cameras_equal_the_published_calibration():
    """It is of images four times as large, with pixel centres at integers."""
    scene = stereo.read()
    for name, cx in (("left", 1244.772), ("right", 1369.115)):
        K = scene.cameras[name].K
        assert np.allclose((4 * K[0, 0], 4 * K[1, 1]), 3979.911, rtol=0, atol=2e-3)
        assert np.allclose(4 * K[:2, 2] - 0.5, (cx, 1019.507), rtol=0, atol=3e-3)
    assert scene.cameras["right"].center.tolist() == [0.193001, 0, 0]
