"""The predictor as a whole: crops, units, more views, settings, and bad input."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.predict import load_predictor
from slgaussian.predict.mvsplat.predictor import estimate_near
from slgaussian.scene import Sample, View
from tests.predict.textured_planes import camera, sample


@pytest.fixture(scope="module")
def predict(checkpoint):
    return load_predictor("mvsplat", checkpoint=checkpoint)


def pair(height: int = 64, width: int = 64, **settings: float) -> Sample:
    size = height, width
    scene = {"size": size, "focal": 80.0} | settings
    return sample(camera(**scene), camera(x=0.4, turn=-0.1, **scene))


def scale(scene: Sample, factor: float) -> Sample:
    def view(first: View) -> View:
        c2w = first.camera.c2w.copy()
        c2w[:3, 3] *= factor
        z = {n: getattr(first.camera, n) for n in ("near", "far")}
        z = {name: None if value is None else value * factor for name, value in z.items()}
        return replace(first, camera=replace(first.camera, c2w=c2w, **z), depth=None)

    return replace(scene, context=tuple(map(view, scene.context)))


def distances(gaussians: Gaussians, scene: Sample) -> np.ndarray:
    H, W = scene.context[0].image.shape[:2]
    centres = np.stack([view.camera.center for view in scene.context])
    mine = centres[gaussians.source.numpy() // (H * W)]
    return np.linalg.norm(gaussians.means.numpy() - mine, axis=1)


def test_gaussians_lie_on_the_rays_of_their_pixels(predict):
    # 70 x 90 is cropped to 64 x 80, three rows and five columns off the first; principal points
    # are off the centre.
    scene = pair(70, 90, principal=(40.0, 39.0), near=1.0, far=40.0)
    gaussians = predict(scene)
    gaussians.check()
    assert len(gaussians) == 2 * 64 * 80
    source = gaussians.source.numpy()
    assert (np.diff(source) > 0).all()
    view, pixel = np.divmod(source, 70 * 90)
    row, column = np.divmod(pixel, 90)
    assert (row.min(), row.max(), column.min(), column.max()) == (3, 66, 5, 84)
    for i, context in enumerate(scene.context):
        result, z = context.camera.project(gaussians.means.numpy()[view == i].astype(np.float64))
        assert (z > 0).all()
        off = result - np.stack([column, row], 1)[view == i] - 0.5
        assert np.abs(off).max() < 0.501
    far = distances(gaussians, scene)
    assert far.min() > 0.999
    assert far.max() < 40.001


def test_gaussians_scale_with_the_scene(predict):
    scene = pair(96, 128)
    # By matches, and not by the distance between the views, which is 0.4.
    assert 1.5 < estimate_near(scene) < 2.5
    first, ten = predict(scene), predict(scale(scene, 10.0))
    # The same numbers to rounding: matches are triangulated in float64.
    torch.testing.assert_close(ten.means, 10 * first.means, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(ten.scales, 10 * first.scales, rtol=1e-4, atol=0)
    torch.testing.assert_close(ten.sh, first.sh, rtol=0, atol=1e-3)
    torch.testing.assert_close(ten.opacities, first.opacities, rtol=0, atol=1e-4)


def test_without_matches_the_baseline_is_the_unit():
    scene = pair()
    blank = [
        replace(view, image=np.full_like(view.image, 90 + 20 * i))
        for i, view in enumerate(scene.context)
    ]
    assert estimate_near(replace(scene, context=tuple(blank))) == pytest.approx(0.4)


def test_the_world_frame_does_not_matter(predict):
    scene = pair(near=1.0)
    turn = np.eye(4)
    turn[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    turn[:3, 3] = 3.0, -2.0, 5.0

    def move(view: View) -> View:
        return replace(view, camera=replace(view.camera, c2w=turn @ view.camera.c2w))

    here = predict(scene)
    inside = predict(replace(scene, context=tuple(map(move, scene.context))))
    moved = here.means @ torch.from_numpy(turn[:3, :3].T).float() + torch.tensor([3.0, -2.0, 5.0])
    torch.testing.assert_close(inside.means, moved, rtol=0, atol=2e-4)
    torch.testing.assert_close(inside.scales, here.scales, rtol=1e-4, atol=1e-6)


def test_the_smallest_image(predict):
    assert len(predict(pair(16, 31, near=1.0))) == 2 * 16 * 16
    with pytest.raises(InputError, match="at least 16x16"):
        predict(pair(15, 31, near=1.0))


def test_bfloat16_is_near(predict, checkpoint):
    scene = pair(near=1.0)
    exact = predict(scene)
    half = load_predictor("mvsplat", checkpoint=checkpoint, precision="bfloat16")(scene)
    half.check()
    assert {value.dtype for _, value in half.items()} == {torch.float32, torch.int32}
    depth, second = distances(exact, scene), distances(half, scene)
    off = np.abs(second / depth - 1)
    # Measured with these weights: 0.2 % and 2 %; opacity 0.003.
    assert off.mean() < 0.01
    assert off.max() < 0.06
    assert (half.opacities - exact.opacities).abs().max() < 0.01


@pytest.mark.parametrize(
    "settings", [{"checkpoint": None}, {"precision": "float16"}, {"device": "abacus"}]
)
def test_bad_settings(settings, checkpoint):
    with pytest.raises(InputError, match=f"mvsplat {next(iter(settings))}"):
        load_predictor("mvsplat", **{"checkpoint": checkpoint} | settings)


def test_near_must_be_below_far(predict):
    scene = pair()
    views = (replace(v, camera=replace(v.camera, far=1e-6)) for v in scene.context)
    with pytest.raises(InputError, match="is not below far 1e-06"):
        predict(replace(scene, context=tuple(views)))
