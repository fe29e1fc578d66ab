"""Every stage gives the numbers of the published implementation.

``reference.npz`` has inputs and outputs of github donydchen/mvsplat 175b17a, float32 on the CPU, at
64 x 64 with the weights of ``benches/predict/random_mvsplat_weights.py``: of each stage
:data:`COUNT` values, and the largest difference between two ways to compute it ("floor": oneDNN on
and off); a digest of the names and shapes of all weights; rotations of harmonics by e3nn 0.6.
"""

import hashlib
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from slgaussian.gaussians import Gaussians, rotation_matrices
from slgaussian.predict.mvsplat import adapter
from slgaussian.predict.mvsplat.depth import COMPUTED_CHANNELS
from slgaussian.rasterize import harmonics
from tests.predict.textured_planes import camera
from tests.rasterize.test_harmonics import scipy_basis

COUNT = 2000
FILE = Path(__file__).with_name("reference.npz")
LEFT_OUT = {"floor/disparity_head", "floor/rotations_xyzw_local"}
STAGES = [name[6:] for name in np.load(FILE).files if "floor/" in name and name not in LEFT_OUT]

NOISE = 5
"""Allowed error over the reference's own, between two ways to compute it. Measured on one machine:
3.0 in the cost volume, whose values reach 175, and at most 1.8 elsewhere."""


@pytest.fixture(scope="module")
def result(network, reference, cameras) -> dict[str, np.ndarray]:
    """Outputs of our network at every stage, in the shapes of the reference."""
    observed: dict[str, torch.Tensor] = {}
    depth = network.depth_predictor

    def see_inputs(name):
        return lambda _, inputs: observed.__setitem__(name, inputs[0].clone())

    def see_outputs(*names):
        def hook(_, __, outputs):
            outputs = outputs if isinstance(outputs, tuple) else (outputs,)
            observed.update(zip(names, [o.clone() for o in outputs], strict=True))

        return hook

    hooks = [
        network.backbone.register_forward_hook(see_outputs("cnn_features", "trans_features")),
        depth.corr_refine_net.register_forward_pre_hook(see_inputs("cost_volume_in")),
        depth.depth_head_lowres.register_forward_pre_hook(see_inputs("cost_volume_refined")),
        depth.depth_head_lowres.register_forward_hook(see_outputs("depth_logits")),
        depth.proj_feature.register_forward_hook(see_outputs("proj_feature")),
        depth.refine_unet.register_forward_pre_hook(see_inputs("refine_in")),
        depth.refine_unet.register_forward_hook(see_outputs("refine_out")),
    ]
    images = torch.from_numpy(reference["input/image"])
    with torch.no_grad():
        message = network(images, cameras, near=1.0, far=100.0)
        lifted = [
            adapter.make_gaussians(*view)
            for view in zip(message.disparity, message.raw, cameras, strict=True)
        ]
    for hook in hooks:
        hook.remove()
    fields = {name: torch.cat([view[name] for view in lifted]) for name in lifted[0]}
    count = len(fields["means"])
    gaussians = Gaussians(
        **fields, opacities=message.opacity.flatten(), source=torch.arange(count, dtype=torch.int32)
    )
    # Of 84 and 25 numbers ours leaves out those that nothing draws.
    raw = torch.full((count, 84), torch.nan)
    raw[:, COMPUTED_CHANNELS] = message.raw.reshape(count, -1)
    # And ours are coefficients of another basis.
    cycled = torch.from_numpy(harmonics.rotation_matrix(adapter.CYCLE)).float()
    sh = torch.full((count, 3, 25), torch.nan)
    sh[..., :16] = gaussians.sh.mT @ cycled.T
    factor = rotation_matrices(gaussians.quats) * gaussians.scales[:, None]
    observed |= {
        "depths": 1 / message.disparity,
        "densities": message.opacity,
        "raw_gaussians": raw,
        "scales_local": gaussians.scales,
        "means": gaussians.means,
        "covariances": factor @ factor.mT,
        "harmonics": sh,
        "opacities": gaussians.opacities,
    }
    return {name: value.numpy() for name, value in observed.items()}


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_is_the_reference(result, reference, stage):
    # The places were drawn at random by the name of the stage.
    rng = np.random.default_rng(zlib.crc32(stage.encode()))
    ours = result[stage].ravel()[rng.integers(0, result[stage].size, COUNT)]
    left_out = np.isnan(ours)
    assert left_out.mean() < 0.4
    off = np.abs(ours - reference[stage])[~left_out].max()
    assert off < NOISE * reference[f"floor/{stage}"]


def test_names_and_shapes_are_the_published(network, reference):
    state = network.state_dict()
    assert len(state) == 471
    assert sum(value.numel() for value in state.values()) == 11_955_734
    lines = [f"{name} {tuple(value.shape)}" for name, value in state.items()]
    assert hashlib.sha256("\n".join(lines).encode()).hexdigest() == str(reference["names"])


def e3nn_basis(directions: np.ndarray) -> np.ndarray:
    """Real harmonics [N, 16] of unit vectors [N, 3] as e3nn has them, float64.

    y is the polar axis and the azimuth goes from z to x; without the phase, degree 1 is (x, y, z).
    """
    phase = [(-1) ** m for degree in range(4) for m in range(-degree, degree + 1)]
    return scipy_basis(directions[:, [2, 0, 1]], 3) * phase


def test_the_basis_is_that_of_e3nn(reference):
    theirs = np.concatenate([reference[f"e3nn/Y{degree}"] for degree in range(4)], 1)
    # Theirs are in float32.
    np.testing.assert_allclose(e3nn_basis(reference["e3nn/dirs"].astype(float)), theirs, atol=2e-6)


def test_lifted_gaussians_have_these_colours():
    """As the renderer sees them, in float32: positions, order of channels and 0.5 included."""
    first = camera(size=(8, 8), focal=10.0, x=0.4, y=-0.2, turn=0.5)
    generator = torch.Generator().manual_seed(0)
    raw = torch.randn(8, 8, 57, generator=generator)
    fields = adapter.make_gaussians(torch.full((8, 8), 0.5), raw, first)
    rest = {"opacities": torch.ones(64), "source": torch.arange(64, dtype=torch.int32)}
    gaussians, eye = Gaussians(**fields, **rest), np.array([0.3, 1.0, -0.7])
    window = replace(first, c2w=np.block([[np.eye(3), eye[:, None]], [0, 0, 0, 1]]))
    d = gaussians.means.double().numpy() - eye
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    Y = e3nn_basis(d * [-1, 1, -1] @ first.c2w[:3, :3])
    Y *= np.repeat([1, 0.025, 0.00625, 0.0015625], [1, 3, 5, 7])
    predicted = raw.double().numpy().reshape(64, 57)[:, 9:].reshape(64, 3, 16)
    published = np.maximum(0, 0.5 + np.einsum("nk,nck->nc", Y, predicted))
    # Measured 2e-7.
    np.testing.assert_allclose(harmonics.compute_colours(gaussians, window), published, atol=1e-6)
