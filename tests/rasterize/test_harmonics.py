"""Spherical harmonics against SciPy's, which share neither code nor form with ours."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize.harmonics import BANDS, compute_colours, evaluate_sh, rotation_matrix
from slgaussian.scene import Camera
from tests import pinhole
from tests.rasterize.hard_cases import splats


def camera(center=(0.0, 0.0, 0.0)) -> Camera:
    return pinhole.camera(48, 32, 40, place=center)


def draw_gaussians(n=40, count=16, dtype=torch.float32, size=0.3) -> Gaussians:
    g = torch.Generator().manual_seed(count)
    means = torch.randn(n, 3, generator=g, dtype=torch.float64)
    sh = size * torch.randn(n, count, 3, generator=g, dtype=torch.float64)
    return make_gaussians(means.to(dtype), sh.to(dtype))


def make_gaussians(means: torch.Tensor, sh: torch.Tensor) -> Gaussians:
    return replace(splats(means), sh=sh)


def directions(n=200) -> np.ndarray:
    d = np.random.default_rng(0).normal(size=(n, 3))
    d[:6] = np.concatenate([np.eye(3), -np.eye(3)])  # the poles, where angles are not unique
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def scipy_basis(d: np.ndarray, degree: int) -> np.ndarray:
    """Real harmonics [N, (degree + 1)^2] of SciPy's complex ones in directions [N, 3]."""
    x, y, z = d.T
    columns = []
    for n in range(degree + 1):
        for m in range(-n, n + 1):
            value = sph_harm_y(n, abs(m), np.arccos(z), np.arctan2(y, x))
            columns.append((value.imag if m < 0 else value.real) * (2**0.5 if m else 1.0))
    return np.stack(columns, -1)


def test_evaluate_sh_equals_scipy_with_condon_shortley_phase():
    d = directions()
    # Measured 8e-16, most of it from arccos and arctan2.
    harmonics = evaluate_sh(torch.from_numpy(d.T), 3).T
    np.testing.assert_allclose(harmonics, scipy_basis(d, 3), atol=1e-14)


@pytest.mark.parametrize("count", [1, 4, 9, 16])
def test_colors_are_half_plus_the_harmonics_of_the_direction(count):
    splats, eye = draw_gaussians(count=count, size=1), np.array([0.3, -0.2, 0.5])
    d = splats.means.double().numpy() - eye
    Y = scipy_basis(d / np.linalg.norm(d, axis=1, keepdims=True), round(count**0.5) - 1)
    expected = np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", Y, splats.sh.double().numpy()))
    assert (expected == 0).any()  # the clamp is part of what is compared
    # Float32 noise, measured on 4,000 Gaussians: at most 9e-7, in sums of 16 products.
    np.testing.assert_allclose(compute_colours(splats, camera(eye)), expected, atol=2e-6)


def test_rotation_matrix_equals_harmonics_of_rotated_directions():
    d = torch.from_numpy(directions().T.copy())
    for R in Rotation.random(5, random_state=0).as_matrix():
        D = rotation_matrix(R)
        # Measured 9e-16 and 3e-15, from the pseudo-inverse.
        np.testing.assert_allclose(
            D @ evaluate_sh(d, 3).numpy(), evaluate_sh(torch.tensor(R) @ d, 3), atol=1e-14
        )
        np.testing.assert_allclose(D @ D.T, np.eye(16), atol=1e-14)
        for band in BANDS:
            D[band, band] = 0
        assert not D.any()


@pytest.mark.parametrize("count", [4, 16])
def test_colors_gradients_equal_finite_differences(count):
    splats = draw_gaussians(
        6, count, torch.float64, size=0.05
    )  # small, so that no colour is at the clamp

    def run(means, sh):
        return compute_colours(make_gaussians(means, sh), camera((0.1, 0.2, 0.3)))

    assert (run(splats.means, splats.sh) > 0).all()
    inputs = (splats.means.requires_grad_(), splats.sh.requires_grad_())
    assert torch.autograd.gradcheck(run, inputs)


def test_colors_of_a_mean_at_the_camera_are_plain_with_finite_gradients():
    splats = draw_gaussians(3)
    splats.sh.abs_()
    splats.means[1] = torch.tensor([0.5, 0.25, 2.0])
    splats.means.requires_grad_()
    splats.sh.requires_grad_()
    view = compute_colours(splats, camera((0.5, 0.25, 2.0)))
    assert torch.equal(view[1], splats.colours()[1])
    view.sum().backward()
    assert splats.means.grad.isfinite().all()
    assert splats.sh.grad.isfinite().all()
    assert (splats.means.grad[1] == 0).all()
    assert (splats.sh.grad[1, 1:] == 0).all()
    assert (splats.means.grad[0] != 0).any()


def test_colors_keep_directions_a_million_units_away():
    splats = draw_gaussians()
    # Eighths are exact at a million in float32; the camera's thousandths are not.
    splats.means[:] = (splats.means * 8).round() / 8
    far = make_gaussians(splats.means + 1e6, splats.sh)
    eye = np.array([0.321, 0.123, 0.777])
    near_seen, far_seen = (
        compute_colours(splats, camera(eye)),
        compute_colours(far, camera(eye + 1e6)),
    )
    # float64 keeps 1e-10 of a unit at a million; to lose the thousandths would change 0.1.
    np.testing.assert_allclose(far_seen, near_seen, atol=1e-6)


@pytest.mark.parametrize("count", [5, 25])
def test_colors_refuse_other_numbers_of_coefficients(count):
    sentence = f"found {count} coefficients a colour, expected one of 1, 4, 9, 16"
    with pytest.raises(InputError, match=sentence):
        compute_colours(draw_gaussians(count=count), camera())
