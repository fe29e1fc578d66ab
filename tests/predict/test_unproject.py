"""Gaussians as discs along the surface."""

import numpy as np
import pytest
import torch
from textured_planes import NORMAL, Plane, camera, sample

from slgaussian.gaussians import rotation_matrices, source_depths
from slgaussian.predict.unproject import normals, unproject

# Written out, not imported: a slip in the module must show here.
FOOTPRINT, THICKNESS = 0.35, 0.1

CAMERAS = (camera(turn=0.2, focal=140, principal=(70, 50)), camera(x=0.4, y=0.1, turn=-0.1))


@pytest.fixture(scope="module")
def lift():
    views = sample(*CAMERAS).context
    inverse_depths = [1 / view.depth for view in views]
    opacities = [np.full(view.depth.shape, 0.5, np.float32) for view in views]
    colors = [(view.image / 255).astype(np.float32) for view in views]
    return views, unproject(CAMERAS, colors, inverse_depths, opacities)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.4, -0.3, 1.0), (0.0, 1.2, 1.0)])
def test_normals_of_a_plane_are_its_own(normal):
    view_camera = camera(principal=(90, 40))
    normal = np.array(normal) / np.linalg.norm(normal)
    depth = Plane(normal, 3.0).depth(view_camera)
    assert (depth > 0).all()
    result = normals((1 / depth).astype(np.float32), view_camera.K)
    angle = np.degrees(np.arccos(np.clip(-(result @ normal), -1, 1)))
    # float32 inverse depths: slopes over 7 pixels are known to 1e-7, angles to 0.01 degrees.
    assert angle.max() < 0.02


def test_normals_do_not_mix_two_surfaces():
    depth = np.full((40, 60), 2.0)
    depth[:, 30:] = 4.0
    result = normals((1 / depth).astype(np.float32), camera(size=(40, 60)).K)
    assert np.allclose(result, [0, 0, -1], atol=1e-4)


def test_one_gaussian_a_pixel_at_the_given_depth(lift):
    views, gaussians = lift
    assert len(gaussians) == 2 * 120 * 160
    assert torch.equal(gaussians.source, torch.arange(len(gaussians), dtype=torch.int32))
    gaussians.check()
    depths = source_depths(gaussians, CAMERAS)
    assert np.allclose(depths, [view.depth for view in views], rtol=1e-5)
    colors = gaussians.colours().reshape(2, 120, 160, 3).numpy() * 255
    assert np.allclose(colors, [view.image for view in views], atol=1e-3)


def test_discs_are_thin_and_lie_along_the_surface(lift):
    _, gaussians = lift
    R = rotation_matrices(gaussians.quats).numpy()
    assert np.allclose(np.linalg.det(R), 1, atol=1e-5)
    normal = NORMAL / np.linalg.norm(NORMAL)
    assert np.abs(np.abs(R[:, :, 2] @ normal) - 1).max() < 1e-4
    ratio = (gaussians.scales[:, 2] / gaussians.scales[:, 0]).numpy()
    assert np.allclose(ratio, THICKNESS)


def test_a_disc_covers_its_pixel_evenly(lift):
    _, gaussians = lift
    first = CAMERAS[0]
    some = torch.arange(0, 120 * 160, 97)
    factor = rotation_matrices(gaussians.quats[some]) * gaussians.scales[some][:, None]
    sigma = (factor @ factor.mT).double().numpy()
    means = gaussians.means[some].double().numpy()
    # Project the covariance by finite differences of the true projection.
    J = np.stack(
        [(first.project(means + 1e-5 * e)[0] - first.project(means - 1e-5 * e)[0]) / 2e-5
         for e in np.eye(3)], -1)  # fmt: skip
    spread = np.sqrt(np.linalg.eigvalsh(J @ sigma @ J.transpose(0, 2, 1)))
    # Off-axis, perspective stretches a disc across the line of sight by up to 1 / cos^2 of the
    # field angle (1.35 in the corners here), and the two focal lengths differ by 2 %.
    assert spread.min() > 0.95 * FOOTPRINT
    assert spread.max() < 1.4 * FOOTPRINT
