"""Merged Gaussians are even, flat and of one object; no view changes by a grey level."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.predict.unproject import unproject
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.merging import MAX_VIEW_CHANGE, merge
from slgaussian.scene import Camera
from tests.kernel_threads import kernels_on
from tests.pinhole import camera

H, W = 42, 54
GREY = 1 / 255


CAMERAS = [camera(W, H, 60), camera(W, H, 60, place=(0.2, 0, 0))]


def wall(colour=None, depth=None, labels=None, opacity=0.9) -> Gaussians:
    """Return one Gaussian for each pixel of two views with equal values in both."""
    colour = np.full((H, W, 3), 0.6, np.float32) if colour is None else colour.astype(np.float32)
    depth = np.full((H, W), 3.0, np.float32) if depth is None else depth.astype(np.float32)
    light = np.full((H, W), opacity, np.float32)
    splats = unproject(CAMERAS, [colour] * 2, [1 / depth] * 2, [light] * 2)
    if labels is None:
        return splats
    codes = np.concatenate([labels, labels]).reshape(-1, 1).astype(np.float32)
    return replace(splats, features=torch.from_numpy(np.concatenate([codes, codes > 0], 1)))


def noise(levels: float) -> np.ndarray:
    return 0.5 + np.random.default_rng(0).uniform(-levels, levels, (H, W, 3)) * GREY


def render_colors(gaussians: Gaussians, view: Camera) -> np.ndarray:
    drawn = rasterize(gaussians, None, view)
    return (drawn.values / drawn.alpha.clamp_min(0.5)[..., None]).clamp(0, 1).numpy()


def test_merge_reduces_a_plain_wall_without_visible_change():
    plain = wall()
    merged = merge(plain, CAMERAS)
    assert len(merged.gaussians) < 0.3 * len(plain)
    for view in (*CAMERAS, *(camera(W, H, 60, place=(x, 0, 0)) for x in (0.1, 0.4))):
        inner = slice(4, -4), slice(4, -10)  # beyond the border of both there is nothing
        assert (
            np.abs(render_colors(merged.gaussians, view) - render_colors(plain, view))[inner].max()
            < 2 * GREY
        )
        alpha = rasterize(merged.gaussians, None, view).alpha.numpy()[inner]
        assert alpha.min() > 0.97


def test_merge_keeps_uneven_gaussians_that_no_view_sees():
    rough, screen = wall(noise(20)), wall(depth=np.full((H, W), 1.0), opacity=1.0)
    merged = merge(Gaussians.concatenate([rough, screen]), CAMERAS)
    assert len(merged.gaussians) == len(rough) + len(screen)


@pytest.mark.parametrize("levels", [2, 6, 10])
def test_merge_measures_and_bounds_the_change(levels):
    speckled = wall(noise(levels))
    merged = merge(speckled, CAMERAS)
    changes = [
        np.abs(render_colors(merged.gaussians, c) - render_colors(speckled, c)) / GREY
        for c in CAMERAS
    ]
    rms = max(np.sqrt((c.astype(np.float64) ** 2).mean()) for c in changes)
    measured = merged.change.mean, merged.change.rms, merged.change.greatest
    assert measured == pytest.approx((np.mean(changes), rms, np.max(changes)), rel=1e-4)
    assert merged.change.rms <= MAX_VIEW_CHANGE / GREY


def test_merge_is_undone_beside_dark_lines():
    # Dark lines two pixels wide on a wall: what is merged beside them must not blur them.
    colour = np.full((H, W, 3), 0.6)
    colour[:, 20:22] = 0.1
    lined = wall(colour)
    merged = merge(lined, CAMERAS)
    assert len(merged.gaussians) < 0.5 * len(lined)
    columns = lined.source.numpy() % W
    for column in range(18, 24):
        local = merged.into[columns == column]
        assert len(np.unique(local)) == len(local)


def unproject_three_views(z: float, colour, depth: float, light: float, others=None):
    """Gaussians of the two views of the wall and of a third, at ``z`` on the way to it."""
    cameras = [*CAMERAS, camera(W, H, 60, place=(0.1, 0, z))]
    others = noise(6) if others is None else others
    colours = [image.astype(np.float32) for image in (others, others, colour)]
    depths = [np.full((H, W), d, np.float32) for d in (3, 3, depth)]
    lights = [np.full((H, W), value, np.float32) for value in (0.9, 0.9, light)]
    return unproject(cameras, colours, [1 / d for d in depths], lights), cameras


@pytest.mark.parametrize(
    ("z", "colour", "depth", "light"),
    [
        # All views change alike everywhere, by more than a grey level: most of it may stay.
        (2.5, noise(6), 0.5, 0.9),
        # What is wide in a view close to the wall reaches into it from far beyond its border.
        (2.8, np.full((H, W, 3), 0.5), 5, 0.02),
        (2.95, np.full((H, W, 3), 0.5), 5, 0.02),
    ],
)
def test_merge_is_undone_only_where_one_view_changes_too_much(z, colour, depth, light):
    merged = merge(*unproject_three_views(z, colour, depth, light))
    assert len(merged.gaussians) < 0.9 * 3 * H * W
    assert 0.5 < merged.change.rms <= MAX_VIEW_CHANGE / GREY


def test_merge_ignores_changes_behind_a_surface():
    """A view from behind has an uneven screen before it, and all that others see is hidden."""
    plain = np.full((H, W, 3), 0.6)
    merged = merge(*unproject_three_views(-5, noise(7), 1, 1.0, plain))
    local = merged.gaussians.source.numpy() < 2 * H * W
    assert local.sum() < 0.3 * 2 * H * W and (~local).sum() > 0.8 * H * W


def test_merge_keeps_objects_apart():
    labels = np.ones((H, W))
    labels[11:31, 13:37] = 2
    labels[0:8] = 0
    both = wall(labels=labels)
    merged = merge(both, CAMERAS)
    assert len(merged.gaussians) < 0.6 * len(both)
    assert torch.equal(merged.gaussians.features[merged.into], both.features)


def test_merge_keeps_surfaces_at_other_depths_apart():
    depth = np.full((H, W), 3.0)
    depth[:, 25:] = 2.0
    step = wall(depth=depth)
    merged = merge(step, CAMERAS)
    near = step.means[:, 2] < 2.5
    z = merged.gaussians.means[merged.into, 2]
    assert torch.equal(z < 2.5, near) and float((z - step.means[:, 2]).abs().max()) < 1e-5
    assert len(merged.gaussians) < 0.6 * len(step)


def test_merge_keeps_a_slanted_surface_flat():
    x = np.arange(W) + 0.5
    depth = np.tile(1 / (0.5 - 0.004 * x), (H, 1))
    slanted = wall(depth=depth)
    merged = merge(slanted, CAMERAS)
    assert len(merged.gaussians) < 0.4 * len(slanted)
    # On the plane 1/z = a + b u both before and after, and no thicker than a fraction of a pixel.
    means = merged.gaussians.means.double().numpy()[merged.into[: H * W]]
    pixels, z = CAMERAS[0].project(means)
    assert np.abs(1 / z - (0.5 - 0.004 * pixels[:, 0])).max() < 1e-3
    assert float(merged.gaussians.scales.min(1).values.max()) < 0.25 * z.max() / 60


def test_merge_assigns_each_pixel_to_its_cell():
    merged = merge(wall(), CAMERAS)
    source, into = merged.gaussians.source.numpy(), merged.into
    assert sorted(set(into)) == list(range(len(source)))
    members = np.bincount(into)
    assert set(np.unique(members)) <= {1, 4, 16}
    first = np.full(len(source), 10**9)
    np.minimum.at(first, into, np.arange(len(into)))
    assert (source == first).all()  # a Gaussian a pixel here: the number is the pixel


def test_merge_keeps_holes_and_further_gaussians():
    plain = wall()
    holes = (torch.arange(2 * H * W) % 7 != 3) | (torch.arange(2 * H * W) % W > 30)
    further = replace(plain[torch.arange(40)], means=plain.means[:40] + torch.tensor([0, 0, 1.5]))
    inputs = Gaussians.concatenate([plain[holes], further])
    merged = merge(inputs, CAMERAS)
    assert len(merged.gaussians) < 0.75 * len(inputs)
    last = merged.gaussians[merged.into[-40:]]
    for name, values in last.items():
        assert torch.equal(values, getattr(further, name)), name
    columns = inputs.source.numpy()[:-40] % W
    beside = merged.into[:-40][columns < 28]
    assert len(np.unique(beside)) == len(beside)


def test_merge_is_equal_for_any_number_of_threads():
    result = []
    for threads in (1, 2):
        with kernels_on(threads):
            merged = merge(wall(noise(8)), CAMERAS)
        fields = [values.numpy().tobytes() for _, values in merged.gaussians.items()]
        result.append((fields, merged.change))
    assert result[0] == result[1]


def test_merge_accepts_no_gaussians_and_refuses_wrong_cameras():
    nothing = wall()[:0]
    assert len(merge(nothing, CAMERAS).gaussians) == 0
    for cameras, sentence in (
        ([], r"merge cameras: found sizes \[\], expected one size"),
        ([CAMERAS[0], camera(W + 1, H, 60)], "expected one size"),
        (CAMERAS[:1], f"expected those of 1 views of {W}x{H}"),
    ):
        with pytest.raises(InputError, match=sentence):
            merge(wall(), cameras)


def test_merge_decides_guessed_by_majority():
    guesses = torch.zeros(2, H, W, dtype=torch.bool)
    guesses[:, :, 18:] = True  # three quarters of a cell of eight, half of one of four
    merged = merge(replace(wall(), guessed=guesses.ravel()), CAMERAS)
    into = merged.into
    shares = np.bincount(into, guesses.ravel().numpy()) / np.bincount(into)
    assert ((shares > 0) & (shares < 1)).any()
    assert np.array_equal(merged.gaussians.guessed.numpy(), shares > 0.5)
