"""Weights by Gaussian and label are those of the float64 reference."""

import numpy as np
import torch

from slgaussian.rasterize import rasterize
from slgaussian.rasterize.label_weights import sum_label_weights
from tests.kernel_threads import kernels_on
from tests.pinhole import camera
from tests.rasterize.hard_cases import cloud

SIZE = 45, 37
CAMERAS = [camera(*SIZE, 40), camera(*SIZE, 40, place=(0.3, 0.1, 0))]


def test_label_weights_equal_sums_of_the_reference_and_no_thread_changes_them():
    gaussians, _ = cloud(60)
    labels = np.random.default_rng(0).integers(0, 5, (2, SIZE[1], SIZE[0])).astype(np.int32)
    labels[0, :30, :30] = 3  # blocks of one label
    expected = np.zeros((60, 5))
    for of_view, view in zip(labels, CAMERAS, strict=True):
        single = torch.eye(60, dtype=torch.float64)
        weights = rasterize(gaussians, single, view, backend="reference", settings="exact").values
        for label in range(5):
            expected[:, label] += weights.numpy()[of_view == label].sum(0)
    with kernels_on(1):
        summed = sum_label_weights(gaussians, labels, CAMERAS, 5, "exact").toarray()
    assert expected.max() > 5
    np.testing.assert_allclose(summed, expected, atol=2e-4, rtol=1e-5)
    with kernels_on(3):
        again = sum_label_weights(gaussians, labels, CAMERAS, 5, "exact").toarray()
    assert (again == summed).all()
