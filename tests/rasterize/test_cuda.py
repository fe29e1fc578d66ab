"""gsplat: what is refused without it; where there is a GPU, its pictures against the reference."""

from dataclasses import replace
from importlib.util import find_spec

import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import Settings, rasterize
from slgaussian.rasterize.cuda import load_gsplat
from tests.pinhole import camera
from tests.rasterize.hard_cases import case, cloud

needs_gpu = pytest.mark.skipif(
    not torch.cuda.is_available() or find_spec("gsplat") is None,
    reason="needs a CUDA device and gsplat",
)

TOLERANCE = 0.03
"""gsplat's cut-offs, 1/255 and 3.33 sigma. Their formulas in float64 on the CPU give 1.1e-2 in
values, 1.5e-2 in alpha and 1e-2 in relative depth on these cases."""
CASES = [
    "ordinary_cloud", "dense_overlap", "subpixel", "pancakes", "opacity_1", "equal_depths",
    "quaternions_near_zero", "focal_50000", "a_million_units_away", "principal_point_far_outside",
    "image_of_17x33", "three_hundred_channels", "no_channel", "nothing",
]  # fmt: skip


def move_to_gpu(splats: Gaussians) -> Gaussians:
    return Gaussians(**{name: t.cuda() for name, t in splats.items()})


@pytest.mark.parametrize(
    ("view", "options", "sentence"),
    [
        (camera(), {}, "gaussians means: found on device 'cpu', expected all tensors on one CUDA"),
        (camera(), {"median": True}, "no median depth; use backend 'cpu'"),
        (camera(skew=1.5), {}, r"camera K: found a skew of 1\.5 px, expected 0"),
        (camera(), {"settings": Settings(alpha_max=0.5)}, r"alpha_max: found 0\.5, expected 0\.99"),
    ],
)
def test_cuda_refuses_requests_that_gsplat_lacks(view, options, sentence):
    with pytest.raises(InputError, match=sentence):
        rasterize(*cloud(5), view, backend="cuda", **options)


@pytest.mark.skipif(find_spec("gsplat") is not None, reason="gsplat is installed")
def test_load_gsplat_names_the_install_line_without_gsplat():
    with pytest.raises(InputError, match=r"No module named 'gsplat'.*pip install 'gsplat"):
        load_gsplat()


@needs_gpu
@pytest.mark.parametrize("name", CASES)
def test_cuda_renders_as_the_reference(name):
    scene = case(name)
    true = rasterize(*scene, backend="reference", settings=Settings())
    drawn = rasterize(move_to_gpu(scene.gaussians), scene.values.cuda(), scene.camera)
    assert drawn.values.is_cuda
    assert drawn.values.shape == true.values.shape
    torch.testing.assert_close(drawn.values.cpu().double(), true.values, atol=TOLERANCE, rtol=0)
    torch.testing.assert_close(drawn.alpha.cpu().double(), true.alpha, atol=TOLERANCE, rtol=0)
    solid = true.alpha > 0.5
    torch.testing.assert_close(
        drawn.depth.cpu().double()[solid], true.depth[solid], atol=0, rtol=TOLERANCE
    )


@needs_gpu
def test_cuda_has_the_gradients_of_the_reference():
    splats, values = cloud(60, 2)
    result = []
    for backend, move in (("reference", torch.clone), ("cuda", torch.Tensor.cuda)):
        leaves = {
            name: move(getattr(splats, name)).requires_grad_()
            for name in ("means", "scales", "quats", "opacities")
        }
        carried = move(values).requires_grad_()
        rest = {"sh": move(splats.sh), "source": move(splats.source)}
        moved = replace(splats, **leaves, **rest)
        drawn = rasterize(moved, carried, camera(), backend=backend, settings="exact")
        (drawn.values.square().sum() + drawn.alpha.square().sum()).backward()
        result.append([leaf.grad.cpu().double() for leaf in (*leaves.values(), carried)])
    for true, fast in zip(*result, strict=True):
        assert (fast - true).norm() < 0.2 * true.norm()
