"""Fast ways against obvious ones: windows, correlation."""

from functools import partial
from itertools import permutations

import pytest
import torch
import torch.nn.functional as F

from slgaussian.predict.mvsplat import cost_volume, transformer
from tests.predict.textured_planes import camera


def test_a_view_attends_to_all_others():
    torch.manual_seed(0)
    block = transformer.Block(16).requires_grad_(False)
    x = torch.randn(3, 4, 4, 16)
    full = block(x, 2, shifted=False)
    for changed in range(3):
        second = x.clone()
        second[changed] += 1
        differs = (block(second, 2, shifted=False) - full).abs().amax((1, 2, 3)) > 1e-4
        assert differs.all()
    torch.testing.assert_close(block(x[[0, 2, 1]], 2, shifted=False), full[[0, 2, 1]])


RIGS = {
    "sideways": (camera(), camera(x=0.4, turn=-0.1)),
    "forward": (camera(), camera(x=0.05, z=0.9)),
    "behind": (camera(), camera(z=3.0, turn=3.0)),
    "two zooms": (camera(focal=120), camera(x=0.3, focal=220, principal=(50, 90))),
    "three": (camera(), camera(x=0.3), camera(y=-0.3, turn=0.2)),
}


def plain_correlation(features, cameras, disparities):
    """By warping everything with grid_sample; float64."""
    views, channels, h, w = features.shape
    out = torch.zeros(views, h, w, len(disparities), dtype=torch.float64)
    v, u = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    pixels = torch.stack([u, v, torch.ones_like(u)], -1).double()
    size = torch.tensor([w - 1, h - 1])
    for i in range(views):
        for j in set(range(views)) - {i}:
            K_i, K_j = (torch.from_numpy(cameras[n].resize(w, h).K) for n in (i, j))
            motion = torch.from_numpy(cameras[j].w2c @ cameras[i].c2w)
            for d, disparity in enumerate(disparities.double()):
                points = pixels @ K_i.inverse().T / disparity @ motion[:3, :3].T + motion[:3, 3]
                view = points @ K_j.T
                grid = view[..., :2] / view[..., 2:].clamp(min=1e-3)
                warped = F.grid_sample(
                    features[j : j + 1].double(), (grid / size * 2 - 1)[None], align_corners=True
                )[0]
                out[i, ..., d] += (features[i] * warped).sum(0)
    return out / (channels**0.5 * (views - 1))


@pytest.mark.parametrize("rig", RIGS)
def test_correlation_is_that_of_warped_features(rig):
    cameras = RIGS[rig]
    generator = torch.Generator().manual_seed(0)
    features = torch.randn(len(cameras), 32, 15, 20, generator=generator)
    disparities = cost_volume.spread(1.0, 100.0, 24)
    plain = plain_correlation(features, cameras, disparities)
    fast = cost_volume.correlate(features, cameras, disparities)
    # Values are up to 5. float32 positions are 2e-6 pixels off, and 2e-5 where a point is beside
    # the other camera and flies through its image.
    assert (fast - plain).abs().max() < 2e-4
    anywhere = torch.zeros_like(fast)
    maps = features.permute(0, 2, 3, 1).contiguous()
    for i, j in permutations(range(len(cameras)), 2):
        lines = cost_volume._paths(cameras[i], cameras[j], (15, 20))
        anywhere[i] += cost_volume.warped_products(*lines, maps[i], maps[j], disparities)
    assert (anywhere / (32**0.5 * (len(cameras) - 1)) - plain).abs().max() < 2e-4


def test_strips_leave_no_seams(network, monkeypatch):
    generator = torch.Generator().manual_seed(0)
    sizes = (3, 48, 32), (128, 12, 8), (128, 12, 8), (128, 12, 8)
    inputs = [torch.rand(2, *size, generator=generator) for size in sizes]
    predict = partial(network.depth_predictor, *inputs, cost_volume.spread(1.0, 100.0, 128))
    with torch.no_grad():
        in_one_strip = predict()
        monkeypatch.setattr("slgaussian.predict.mvsplat.depth.STRIP_ROWS", 20)
        strips = predict()
    for first, second in zip(in_one_strip, strips, strict=True):
        torch.testing.assert_close(first, second, rtol=0, atol=5e-6)
