"""Gaussians: rotations, arrays and depth maps."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, rgb_to_sh, rotation_matrices, source_depths
from slgaussian.scene import Camera


def random_gaussians(n=7) -> Gaussians:
    g = torch.Generator().manual_seed(0)
    quats = torch.randn(n, 4, generator=g)
    return Gaussians(
        means=torch.randn(n, 3, generator=g),
        scales=torch.rand(n, 3, generator=g) + 0.1,
        quats=quats / quats.norm(dim=1, keepdim=True),
        opacities=torch.rand(n, generator=g),
        sh=rgb_to_sh(torch.rand(n, 3, generator=g)),
        source=torch.arange(n, dtype=torch.int32),
    )


def test_rotation_matrices_of_unnormalized_quaternions_match_scipy():
    quats = 3 * random_gaussians().quats
    expected = Rotation.from_quat(quats.numpy(), scalar_first=True).as_matrix()
    np.testing.assert_allclose(rotation_matrices(quats), expected, atol=1e-6)


def test_gaussians_of_arrays_create_no_tensors():
    stored = Gaussians.from_arrays(random_gaussians().to_arrays())
    subset = stored[np.arange(len(stored)) < 3]
    assert all(isinstance(value, np.ndarray) for _, value in subset._present())
    shifted = stored.with_arrays(source=stored.to_arrays()["source"] + 1)
    both = Gaussians.concatenate([subset, shifted])
    assert both.source.tolist() == [0, 1, 2, *range(1, 8)]
    assert np.shares_memory(stored.means.numpy(), stored.to_arrays()["means"])


def test_source_depths_puts_each_depth_at_its_pixel():
    cam = Camera(np.array([[4.0, 0, 2], [0, 4, 1.5], [0, 0, 1]]), np.eye(4), 4, 3)
    depth = np.arange(1, 13, dtype=np.float64).reshape(3, 4)
    gaussians = random_gaussians(12)
    gaussians.means[:] = torch.from_numpy(cam.unproject(depth).reshape(-1, 3))
    gaussians.source[:] = torch.arange(12) + 12
    depths = source_depths(gaussians[gaussians.source != 17], [cam, cam])
    assert depths[0].max() == 0
    depth[1, 1] = 0
    np.testing.assert_allclose(depths[1], depth, rtol=1e-6)


def test_arrays_restore_the_same_gaussians():
    gaussians = random_gaussians()
    restored = Gaussians.from_arrays(gaussians.to_arrays())
    assert all(torch.equal(value, getattr(restored, name)) for name, value in gaussians.items())


def test_selection_keeps_rows_together_and_shapes_must_agree():
    g = random_gaussians()
    selected = g[g.source > 3]
    assert selected.source.tolist() == [4, 5, 6] and torch.equal(selected.means, g.means[4:])
    with pytest.raises(InputError, match=r"scales: found shape \(6, 3\), expected \(7, 3\)"):
        Gaussians(g.means, g.scales[:6], g.quats, g.opacities, g.sh, g.source)
