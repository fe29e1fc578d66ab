"""All backends render the same image: easy, named hard, and random scenes."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import PRESETS, Settings, rasterize
from slgaussian.rasterize.harmonics import compute_colours
from slgaussian.scene import Camera
from tests.kernel_threads import kernels_on
from tests.pinhole import camera
from tests.rasterize.hard_cases import (
    ALL_CUT,
    CASES,
    bounds,
    case,
    cloud,
    measure,
    rotate_randomly,
    splats,
)

BACKENDS = ["cpu", "reference"]
EXACT = PRESETS["exact"]


# The hard cases.


@pytest.mark.parametrize("preset", ["exact", "fast"])
@pytest.mark.parametrize("name", CASES)
def test_cpu_equals_the_reference_on_hard_cases(name, preset):
    """Equal up to rounding without cut-offs, and up to the preset's cut-offs with them."""
    if (name, preset) != (ALL_CUT, "fast"):
        assert np.all(np.array(measure(name, preset)) < bounds(name, preset))


def test_fast_drops_thousands_of_gaussians_below_its_threshold():
    """The price of any cut-off, and the one case where it is not small; see ``exact``.

    Where their alphas are above it, long sums hold: measured 1e-4, from the early stop.
    """
    assert measure(ALL_CUT, "fast").alpha > 0.5
    fast, true = (rasterize(*case(ALL_CUT), backend=backend) for backend in BACKENDS)
    assert (fast.values[11, 15] - true.values[11, 15]).abs().max() < 5e-4


# The reference, and the cut-offs, against the formulas spelt out one number at a time.


def render_plainly(output: Gaussians, values: torch.Tensor, view: Camera, chosen: Settings):
    """Image [H, W, C], alpha [H, W] and mean depth [H, W] in plain float64 loops, with cut-offs."""
    world_to_camera, (fx, skew, cx), (_, fy, cy) = view.w2c, *view.K[:2]

    def project(point):
        x, y, z = (r[:3] @ point + r[3] for r in world_to_camera[:3])
        return np.array([(fx * x + skew * y) / z + cx, fy * y / z + cy]), x / z, y / z, z

    drawn = []
    for i, numbers in enumerate(zip(*(t.double().numpy() for _, t in output.items()), strict=True)):
        mean, scale, quat, opacity = numbers[:4]
        place, x, y, z = project(mean)
        if z <= chosen.near:
            continue
        # The derivative of projection, by differences, where the affine approximation is taken.
        half_x, half_y = view.width / (2 * fx), view.height / (2 * fy)
        x = min(max(x, -cx / fx - 0.3 * half_x), (view.width - cx) / fx + 0.3 * half_x)
        y = min(max(y, -cy / fy - 0.3 * half_y), (view.height - cy) / fy + 0.3 * half_y)
        near_it = (view.c2w @ [x * z, y * z, z, 1])[:3]
        step = 1e-5 * z
        steps = step * np.eye(3)
        ends = [(project(near_it + d)[0], project(near_it - d)[0]) for d in steps]
        J = np.stack([(after - before) / (2 * step) for after, before in ends], -1)
        # Rotate the axes: q v q*, with v a quaternion without real part.
        w, v = quat[0] / np.linalg.norm(quat), quat[1:] / np.linalg.norm(quat)
        cov = chosen.low_pass * np.eye(2)
        for axis, length in zip(np.eye(3), scale, strict=True):
            turned = axis + 2 * w * np.cross(v, axis) + 2 * np.cross(v, np.cross(v, axis))
            cov += np.outer(J @ turned, J @ turned) * length**2
        drawn.append((np.float32(z), i, z, place, np.linalg.inv(cov), opacity))
    drawn.sort(key=lambda splat: splat[:2])

    image = np.zeros((view.height, view.width, values.shape[1]))
    alpha, depth = np.zeros((2, view.height, view.width))
    for row in range(view.height):
        for column in range(view.width):
            light = 1.0
            for _, i, z, place, precision, opacity in drawn:
                d = np.array([column + 0.5, row + 0.5]) - place
                squared = d @ precision @ d
                a = min(opacity * math.exp(-squared / 2), chosen.alpha_max)
                if a < chosen.alpha_min or squared > chosen.sigmas**2:
                    continue
                image[row, column] += a * light * values[i].double().numpy()
                depth[row, column] += a * light * z
                light *= 1 - a
                if light < chosen.pass_min:
                    break
            alpha[row, column] = 1 - light
    return image, alpha, depth / np.maximum(alpha, 1e-300)


def make_plain_scene() -> tuple[Gaussians, torch.Tensor, Camera]:
    """Return a camera with all parameters, and splats of every kind."""
    view = camera(14, 10, 12, cx=4, cy=7, skew=1.5, c2w=rotate_randomly(3, (1, 2, 3)), aspect=1.3)
    output, values = cloud(40, 3, 0.6, view, 3)
    output.opacities[:20] = 0.3 + 0.7 * output.opacities[:20]
    output.means[5] = torch.from_numpy(view.center + view.c2w[:3, :3] @ [3, 2, 0.5])  # off-axis
    output.means[6] = torch.from_numpy(view.center - view.c2w[:3, 2])  # behind
    output.means[7] = torch.from_numpy(view.center + 0.1 * view.c2w[:3, 2])  # before 0.2
    return output, values, view


@pytest.mark.parametrize(
    ("backend", "chosen", "tolerance"),
    [
        # Measured 4e-11, from the differences.
        ("reference", EXACT, 1e-8),
        ("reference", replace(EXACT, alpha_max=0.6), 1e-8),
        # Measured 2e-7, and 4e-7 in depth.
        ("cpu", PRESETS["3dgs"], 2e-6),
        ("cpu", Settings(), 2e-6),
        ("cpu", Settings(sigmas=1.5, alpha_min=0.0, pass_min=0.3, alpha_max=0.7, near=3.0), 2e-6),
    ],
    ids=["exact", "clamped", "3dgs", "fast", "coarse"],
)
def test_backends_equal_the_formula_with_cut_offs(backend, chosen, tolerance):
    output, values, view = make_plain_scene()
    image, alpha, depth = render_plainly(output, values, view, chosen)
    drawn = rasterize(output, values, view, backend=backend, settings=chosen)
    np.testing.assert_allclose(drawn.values, image, atol=tolerance)
    np.testing.assert_allclose(drawn.alpha, alpha, atol=tolerance)
    np.testing.assert_allclose(drawn.depth, depth, rtol=2 * tolerance)
    if backend == "cpu":  # there is something to cut
        exact = rasterize(output, values, view, backend="cpu", settings="exact")
        assert (drawn.values - exact.values).abs().max() > 3e-5


# What is asked besides values.


@pytest.mark.parametrize(
    "name",
    ["ordinary_cloud", "dense_overlap", "opacity_1", "a_gaussian_per_pixel", "scales_of_zero",
     "image_of_17x33", "astronomical_and_microscopic", "no_channel", "nothing"],
)  # fmt: skip
def test_cpu_median_depth_equals_the_reference(name):
    fast, true = (
        rasterize(*case(name), backend=backend, settings="exact", median=True).median
        for backend in BACKENDS
    )
    # No pixel here is so close to one half that rounding moves it to another Gaussian.
    torch.testing.assert_close(fast.double(), true, rtol=2e-7, atol=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_median_depth_is_where_alpha_reaches_one_half(backend):
    output = splats([[0, 0, 2.0], [0, 0, 3.0], [0, 0, 5.0]], 100.0, [0.3, 0.4, 0.5])
    drawn = rasterize(output, torch.ones(3, 1), camera(), backend=backend, median=True)
    assert drawn.median[12, 16] == 3  # 0.3, then 0.58
    thin = rasterize(output[:1], torch.ones(1, 1), camera(), backend=backend, median=True)
    assert thin.median.max() == 0
    assert rasterize(output, torch.ones(3, 1), camera(), backend=backend).median is None


@pytest.mark.parametrize("backend", BACKENDS)
def test_rasterize_without_values_renders_harmonics(backend):
    output, _ = cloud(40)
    sh = torch.randn(40, 16, 3, generator=torch.Generator().manual_seed(0))
    output = replace(output, sh=sh)
    drawn = rasterize(output, None, camera(), backend=backend)
    expected = rasterize(output, compute_colours(output, camera()), camera(), backend=backend)
    assert torch.equal(drawn.values, expected.values)
    assert drawn.values.shape == (24, 32, 3)


# Properties.

seeds = st.integers(0, 10_000)


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 60), seeds)
def test_rasterize_is_equal_for_any_input_order(n, seed):
    """No two depths here are equal."""
    output, values = cloud(n, seed)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    item = rasterize(output, values, camera(), median=True)
    alternative = rasterize(output[order], values[order], camera(), median=True)
    for name, drawn in vars(item).items():
        assert torch.equal(drawn, getattr(alternative, name)), name


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 60), seeds)
def test_rasterize_channels_are_independent(n, seed):
    output, values = cloud(n, seed, channels=11)
    together = rasterize(output, values, camera()).values
    for c in range(11):
        alone = rasterize(output, values[:, c : c + 1], camera()).values
        assert torch.equal(together[..., c], alone[..., 0])


@settings(max_examples=60, deadline=None)
@given(seeds, st.sampled_from(["fast", "exact"]))
def test_rasterize_of_finite_input_is_finite(seed, preset):
    """Places to 1e15, scales to 1e12, quaternions to 1e30, and zeros among all of them."""
    rng = np.random.default_rng(seed)

    def sizes(low, high, *shape):
        result = 10 ** rng.uniform(low, high, shape) * rng.choice([-1, 1], shape)
        return torch.from_numpy(np.where(rng.random(shape) < 0.1, 0, result)).float()

    output = splats(
        means=sizes(-10, 15, 30, 3),
        scales=sizes(-12, 12, 30, 3).abs(),
        opacities=sizes(-9, 0, 30).abs(),
        quats=sizes(-30, 30, 30, 4),
    )
    output.quats[(output.quats == 0).all(1)] = 1
    view = camera(24, 17, 10 ** rng.uniform(0, 5), c2w=rotate_randomly(seed))
    image = rasterize(output, torch.ones(30, 2), view, settings=preset, median=True)
    for name, drawn in vars(image).items():
        assert torch.isfinite(drawn).all(), name
        assert drawn.min() >= 0, name
    assert image.alpha.max() <= 1 + 1e-6


# The bytes.


@pytest.mark.parametrize("preset", ["fast", "exact"])
def test_rasterize_is_equal_for_any_number_of_threads(preset):
    output, values = cloud(300, view=camera(100, 80, 90))

    def draw(threads):
        with kernels_on(threads):
            return rasterize(output, values, camera(100, 80, 90), settings=preset, median=True)

    first = draw(1)
    for threads in (2, 2, 7):
        for name, drawn in vars(draw(threads)).items():
            assert torch.equal(drawn, getattr(first, name)), (name, threads)


def test_rasterize_accepts_other_dtypes_and_strides():
    output, values = cloud(40)
    values = values.half()
    drawn = rasterize(output, values.float(), camera())
    double = {name: t.double() for name, t in output.items() if name != "source"}
    wide = Gaussians(**double, source=output.source)
    strided = Gaussians(**{n: torch.stack([t * 0, t], -1)[..., 1] for n, t in output.items()})
    for gaussians in (wide, strided):
        rerun = rasterize(gaussians, values.T.contiguous().T, camera())
        assert rerun.values.dtype == torch.float32
        assert torch.equal(rerun.values, drawn.values)
    assert rasterize(wide, values, camera(), backend="reference").values.dtype == torch.float64


# Refusals.


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("field", "bad", "expected"),
    [
        ("means", math.nan, "holds NaN or infinity"),
        ("scales", math.inf, "holds NaN or infinity"),
        ("quats", -math.inf, "holds NaN or infinity"),
        ("opacities", math.nan, "holds NaN or infinity"),
        ("scales", -0.1, "found .*expected 0 or more"),
        ("opacities", 1.1, "found .*expected 0 to 1"),
        ("opacities", -1e-6, "found .*expected 0 to 1"),
        ("quats", 0.0, "found .*length zero is no rotation"),
    ],
)
def test_rasterize_names_field_and_index_of_bad_gaussians(field, bad, expected, backend):
    output, values = cloud(5)
    getattr(output, field)[4] = bad
    with pytest.raises(InputError, match=rf"gaussians {field}\[4\]: {expected}"):
        rasterize(output, values, camera(), backend=backend)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"values": torch.full((5, 5), math.nan)}, r"values\[0\]: holds NaN or infinity"),
        ({"values": torch.zeros(4, 5)}, r"values: found shape .*expected \(5, C\)"),
        ({"values": torch.zeros(5)}, r"values: found shape .*expected \(5, C\)"),
        ({"values": torch.zeros(5, 2, 2)}, r"values: found shape .*expected \(5, C\)"),
        ({"backend": "opengl"}, "expected one of cpu, cuda, reference"),
        ({"settings": "slow"}, "'slow': expected one of fast, exact, 3dgs"),
    ],
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_rasterize_refuses_bad_arguments(changed, sentence, backend):
    output, values = cloud(5)
    arguments = {"values": values, "camera": camera(), "backend": backend} | changed
    with pytest.raises(InputError, match=f"rasterize.* {sentence}"):
        rasterize(output, **arguments)


@pytest.mark.parametrize(
    "bad",
    [{"near": 0.0}, {"low_pass": 0.0}, {"low_pass": math.nan}, {"alpha_max": 1.5},
     {"alpha_max": 0.0}, {"alpha_min": 1.0}, {"alpha_min": -0.1}, {"sigmas": 0.0},
     {"pass_min": 1.0}, {"pass_min": math.nan}],
)  # fmt: skip
def test_settings_refuse_numbers_out_of_range(bad):
    with pytest.raises(InputError, match=f"rasterize settings {next(iter(bad))}: found"):
        Settings(**bad)
