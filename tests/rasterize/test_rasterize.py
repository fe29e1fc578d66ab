"""The fast rasteriser against the float64 reference, on easy scenes and on named hard ones."""

import numba
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.cpu import ALPHA_MIN
from slgaussian.scene import Camera

# Splats are cut where their alpha falls under 1/4096, and what many of them lose adds up. Measured:
# 7e-4 for 40 splats on 32x24, 1.2e-3 for 400 large ones on 64x48; half a grey level is 2e-3.
TOLERANCE = 2e-3


def camera(width=32, height=24, focal=30.0, cx=None, cy=None, skew=0.0, c2w=None) -> Camera:
    K = np.array(
        [
            [focal, skew, width / 2 if cx is None else cx],
            [0, focal, height / 2 if cy is None else cy],
            [0, 0, 1],
        ]
    )
    return Camera(K, np.eye(4) if c2w is None else c2w, width, height)


def gaussians(means, scales=0.1, opacities=0.8, quats=None) -> Gaussians:
    means = torch.as_tensor(means, dtype=torch.float32).reshape(-1, 3)
    n = len(means)
    return Gaussians(
        means=means,
        scales=torch.as_tensor(scales, dtype=torch.float32).expand(n, 3).contiguous(),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1) if quats is None else quats,
        opacities=torch.as_tensor(opacities, dtype=torch.float32).expand(n).contiguous(),
        sh=torch.zeros(n, 1, 3),
        source=torch.arange(n, dtype=torch.int32),
    )


def cloud(n: int, seed: int = 0, size: float = 0.3) -> tuple[Gaussians, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    means = torch.randn(n, 3, generator=g) * torch.tensor([1.0, 1.0, 0.8])
    means[:, 2] += 4
    made = gaussians(
        means,
        torch.rand(n, 3, generator=g) * size + 0.01,
        torch.rand(n, generator=g),
        torch.randn(n, 4, generator=g),
    )
    return made, torch.rand(n, 5, generator=g)


def compare(made: Gaussians, values: torch.Tensor, seen: Camera, tolerance: float) -> None:
    fast = rasterize(made, values, seen, "cpu")
    true = rasterize(made, values, seen, "reference")
    assert torch.isfinite(fast.values).all()
    assert (fast.values.double() - true.values).abs().max() < tolerance
    assert (fast.alpha.double() - true.alpha).abs().max() < tolerance
    # Where little light was gathered, the mean depth is decided by what the cut-off drops.
    solid = true.alpha > 0.5
    error = ((fast.depth.double() - true.depth) / true.depth.clamp_min(1e-9)).abs()
    assert (error[solid] < 4 * tolerance).all()


def test_sparse_cloud():
    made, values = cloud(40)
    compare(made, values, camera(), TOLERANCE)


def test_dense_overlap_of_large_splats():
    made, values = cloud(400)
    compare(made, values, camera(64, 48, 60), TOLERANCE)


def test_principal_point_outside_the_image_and_skew():
    made, values = cloud(60)
    compare(made, values, camera(cx=-5, cy=40, skew=3.0), TOLERANCE)


def test_rotated_camera_far_from_the_origin():
    """A million units away float32 positions are 0.06 apart: both backends see the same ones."""
    made, values = cloud(40)
    angle = 0.7
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    c2w = np.eye(4)
    c2w[:3, :3] = R
    c2w[:3, 3] = 1e6
    world = (made.means.numpy().astype(np.float64) * 4 @ R.T + 1e6).astype(np.float32)
    moved = gaussians(world, made.scales * 4, made.opacities)
    compare(moved, values, camera(c2w=c2w), TOLERANCE)


@pytest.mark.parametrize("focal", [2.0, 3000.0])
def test_extreme_focal_lengths(focal):
    made, values = cloud(50)
    compare(made, values, camera(focal=focal), TOLERANCE)


def test_needles_and_pancakes():
    made, values = cloud(30)
    shapes = torch.tensor([[1.0, 1e-6, 1e-6], [1.0, 1.0, 1e-6], [1e-6, 1e-6, 1e-6]])
    made = gaussians(made.means, shapes.repeat(10, 1), made.opacities, made.quats)
    compare(made, values, camera(), TOLERANCE)


def test_at_and_behind_the_near_plane():
    made = gaussians([[0, 0, 0.01], [0, 0, -1.0], [0, 0, 0.0], [0, 0, 0.011]], 0.001)
    compare(made, torch.eye(4), camera(), TOLERANCE)
    image = rasterize(made, torch.eye(4), camera())
    assert image.values[..., :3].abs().max() == 0
    assert image.values[..., 3].max() > 0.5


def test_far_off_axis_does_not_explode():
    """The affine approximation of a splat beside the camera must not smear over the image."""
    made = gaussians([[30.0, 0, 0.05], [0, 0, 3]], [[0.5, 0.5, 0.5], [0.1, 0.1, 0.1]])
    compare(made, torch.eye(2), camera(), TOLERANCE)


def test_one_splat_covers_everything():
    made = gaussians([[0, 0, 5.0]], 1e3, 1.0)
    image = rasterize(made, torch.ones(1, 1), camera())
    assert image.alpha.min() > 0.999
    compare(made, torch.ones(1, 1), camera(), TOLERANCE)


@pytest.mark.parametrize("opacity", [0.0, 1e-7, 1 - 1e-7, 1.0])
def test_extreme_opacities(opacity):
    compare(gaussians([[0, 0, 3.0]], 0.2, opacity), torch.ones(1, 2), camera(), TOLERANCE)


def test_ten_thousand_on_one_pixel():
    """Float32 sums over a long list hold where no splat is cut off.

    Around it, where each of the ten thousand is under the cut-off and all together are opaque, the
    fast path draws nothing: the price of any cut-off, and why nobody should build such a scene.
    """
    n = 10_000
    means = torch.zeros(n, 3)
    means[:, 2] = torch.linspace(2, 3, n)
    made = gaussians(means, 0.01, 0.002)
    values = torch.rand(n, 2, generator=torch.Generator().manual_seed(0))
    fast, true = (rasterize(made, values, camera(31, 23), b) for b in ("cpu", "reference"))
    # Measured 1.7e-4, most of it the early stop at 1e-4 of the light.
    assert (fast.values[11, 15].double() - true.values[11, 15]).abs().max() < 5e-4


def test_equal_depths_keep_the_order_given():
    made = gaussians([[0, 0, 3.0]] * 2, 1.0, 1.0)
    image = rasterize(made, torch.eye(2), camera(31, 23))
    middle = image.values[11, 15]
    assert middle[0] > 0.999
    assert middle[1] == 0
    compare(made, torch.eye(2), camera(31, 23), TOLERANCE)


def test_subpixel_splats_keep_their_low_pass_footprint():
    compare(gaussians([[0.013, 0.007, 3.0]], 1e-6, 1.0), torch.ones(1, 1), camera(), TOLERANCE)


def test_nothing_at_all():
    image = rasterize(gaussians(torch.zeros(0, 3)), torch.zeros(0, 3), camera())
    assert image.values.shape == (24, 32, 3)
    assert image.alpha.max() == 0
    assert image.depth.max() == 0


def test_depth_is_that_of_a_solid_plane():
    seen = camera()
    points = seen.unproject(np.full((24, 32), 2.5)).reshape(-1, 3)
    image = rasterize(gaussians(points, 2.5 / 30, 0.99), torch.ones(len(points), 1), seen)
    assert (image.depth[2:-2, 2:-2] - 2.5).abs().max() < 1e-4


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 60), st.integers(0, 10_000))
def test_premultiplied_values_never_exceed_alpha(n, seed):
    made, values = cloud(n, seed)
    image = rasterize(made, values, camera())
    assert (image.values <= image.alpha[..., None] + 1e-5).all()
    assert image.alpha.max() <= 1
    assert image.alpha.min() >= 0


def test_bytes_do_not_depend_on_the_thread_count():
    made, values = cloud(300)
    before = numba.get_num_threads()
    try:
        images = []
        for threads in (1, before):
            numba.set_num_threads(threads)
            images.append(rasterize(made, values, camera(64, 48)).values)
    finally:
        numba.set_num_threads(before)
    assert torch.equal(*images)


def test_the_cut_off_is_below_a_grey_level():
    assert ALPHA_MIN < 1 / 255 / 2


@pytest.mark.parametrize("field", ["means", "scales", "quats", "opacities"])
def test_nan_is_refused_with_field_and_index(field):
    made, values = cloud(5)
    getattr(made, field)[3] = float("nan")
    with pytest.raises(InputError, match=rf"{field}\[3\]"):
        rasterize(made, values, camera())


def test_wrong_values_and_unknown_backend_are_refused():
    made, values = cloud(5)
    with pytest.raises(InputError, match=r"expected \(5, C\)"):
        rasterize(made, values[:4], camera())
    with pytest.raises(InputError, match="expected one of cpu, reference"):
        rasterize(made, values, camera(), "opengl")
