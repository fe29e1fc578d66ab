"""Gaussians: rotations and depth maps."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, rgb_to_sh, rotation_matrices, source_depths
from slgaussian.scene import Camera


def some(n=7, seed=0) -> Gaussians:
    g = torch.Generator().manual_seed(seed)
    quats = torch.randn(n, 4, generator=g)
    return Gaussians(
        means=torch.randn(n, 3, generator=g),
        scales=torch.rand(n, 3, generator=g) + 0.1,
        quats=quats / quats.norm(dim=1, keepdim=True),
        opacities=torch.rand(n, generator=g),
        sh=rgb_to_sh(torch.rand(n, 3, generator=g)),
        source=torch.arange(n, dtype=torch.int32),
    )


def test_rotation_matrices_of_quaternions_of_any_length():
    quats = 3 * some().quats
    expected = Rotation.from_quat(quats.numpy(), scalar_first=True).as_matrix()
    np.testing.assert_allclose(rotation_matrices(quats), expected, atol=1e-6)


def test_gaussians_of_arrays_need_no_tensor():
    made = some()
    stored = Gaussians.from_arrays(made.to_arrays())
    kept = stored[np.array([True] * 3 + [False] * (len(made) - 3))]
    assert all(isinstance(value, np.ndarray) for _, value in kept._present())
    both = Gaussians.concatenated(
        [kept, stored.with_arrays(source=stored.to_arrays()["source"] + 1)]
    )
    assert both.source.tolist() == [0, 1, 2, *(made.source + 1).tolist()]
    # A tensor and the array that it was made of are one memory.
    assert np.shares_memory(stored.means.numpy(), stored.to_arrays()["means"])


def test_source_depths_puts_each_depth_at_its_pixel():
    cam = Camera(np.array([[4.0, 0, 2], [0, 4, 1.5], [0, 0, 1]]), np.eye(4), 4, 3)
    depth = np.arange(1, 13, dtype=np.float64).reshape(3, 4)
    made = some(12)
    made.means[:] = torch.from_numpy(cam.unproject(depth).reshape(-1, 3))
    made.source[:] = torch.arange(12) + 12
    kept = made[made.source != 17]
    depths = source_depths(kept, [cam, cam])
    assert depths[0].max() == 0
    depth[1, 1] = 0
    np.testing.assert_allclose(depths[1], depth, rtol=1e-6)


def test_arrays_round_trip_selection_keeps_rows_together_and_shapes_must_agree():
    made = some()
    again = Gaussians.from_arrays(made.to_arrays())
    assert all(torch.equal(value, getattr(again, name)) for name, value in made.items())
    assert made[made.source > 3].source.tolist() == [4, 5, 6]
    with pytest.raises(InputError, match=r"scales: found shape \(6, 3\), expected \(7, 3\)"):
        Gaussians(made.means, made.scales[:6], made.quats, made.opacities, made.sh, made.source)
