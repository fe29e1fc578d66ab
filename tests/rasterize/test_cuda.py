"""The gsplat backend: refusals without a GPU, and renders against the reference on one."""

from dataclasses import replace
from importlib.util import find_spec

import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import Settings, rasterize
from slgaussian.rasterize.cuda import load_gsplat
from tests.rasterize.hard_cases import make_camera, make_case, random_gaussians

needs_gpu = pytest.mark.skipif(
    not torch.cuda.is_available() or find_spec("gsplat") is None,
    reason="needs a CUDA device and gsplat",
)

TOLERANCE = 0.03
"""For gsplat's cut-offs, 1/255 and 3.33 sigma. Their formulas in float64 on the CPU give 1.1e-2 in
values, 1.5e-2 in alpha and 1e-2 in relative depth on these cases."""
CASES = [
    "ordinary_cloud", "dense_overlap", "subpixel", "pancakes", "opacity_1", "equal_depths",
    "quaternions_near_zero", "focal_50000", "a_million_units_away", "principal_point_far_outside",
    "image_of_17x33", "three_hundred_channels", "no_channel", "no_gaussians",
]  # fmt: skip


@pytest.mark.parametrize(
    ("camera", "options", "message"),
    [
        (make_camera(), {}, "gaussians means: found on device 'cpu', expected all tensors on one"),
        (make_camera(), {"median": True}, "no median depth; use backend 'cpu'"),
        (make_camera(skew=1.5), {}, r"camera K: found a skew of 1\.5 px, expected 0"),
        (make_camera(), {"settings": Settings(alpha_max=0.5)}, r"alpha_max: found 0\.5, .*0\.99"),
    ],
    ids=["tensors-on-cpu", "median", "skew", "alpha_max"],
)
def test_input_that_gsplat_does_not_support_is_refused(camera, options, message):
    with pytest.raises(InputError, match=message):
        rasterize(*random_gaussians(5), camera, backend="cuda", **options)


@pytest.mark.skipif(find_spec("gsplat") is not None, reason="gsplat is installed")
def test_missing_gsplat_error_names_install_command():
    with pytest.raises(InputError, match=r"No module named 'gsplat'.*pip install 'gsplat"):
        load_gsplat()


@needs_gpu
@pytest.mark.parametrize("name", CASES)
def test_cuda_render_matches_reference(name):
    gaussians, values, camera = scene = make_case(name)
    expected = rasterize(*scene, backend="reference", settings=Settings())
    on_gpu = Gaussians(**{field: tensor.cuda() for field, tensor in gaussians.items()})
    actual = rasterize(on_gpu, values.cuda(), camera)
    assert actual.values.is_cuda
    assert actual.values.shape == expected.values.shape
    torch.testing.assert_close(
        actual.values.cpu().double(), expected.values, atol=TOLERANCE, rtol=0
    )
    torch.testing.assert_close(actual.alpha.cpu().double(), expected.alpha, atol=TOLERANCE, rtol=0)
    solid = expected.alpha > 0.5
    torch.testing.assert_close(
        actual.depth.cpu().double()[solid], expected.depth[solid], atol=0, rtol=TOLERANCE
    )


@needs_gpu
def test_cuda_gradients_match_reference():
    gaussians, values = random_gaussians(60, 2)
    gradients = []
    for backend, move in (("reference", torch.clone), ("cuda", torch.Tensor.cuda)):
        leaves = {
            name: move(getattr(gaussians, name)).requires_grad_()
            for name in ("means", "scales", "quats", "opacities")
        }
        values_leaf = move(values).requires_grad_()
        constants = {"sh": move(gaussians.sh), "source": move(gaussians.source)}
        scene = replace(gaussians, **leaves, **constants), values_leaf, make_camera()
        render = rasterize(*scene, backend=backend, settings="exact")
        (render.values.square().sum() + render.alpha.square().sum()).backward()
        gradients.append([leaf.grad.cpu().double() for leaf in (*leaves.values(), values_leaf)])
    for expected, actual in zip(*gradients, strict=True):
        assert (actual - expected).norm() < 0.2 * expected.norm()
