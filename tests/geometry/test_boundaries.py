import cv2
import numpy as np
import pytest
from scipy import ndimage

from slgaussian.geometry.boundaries import (
    boundary_map,
    depth_boundary,
    half_disc,
    texture_codes,
    tone_codes,
)


def test_depth_boundary_is_zero_on_a_slanted_plane():
    rows = np.linspace(1, 0.2, 60)[:, None]  # inverse depth of a floor
    floor = (1 / np.repeat(rows, 80, 1)).astype(np.float32)
    assert depth_boundary(floor).max() < 1e-4  # float32 of inverse depth near 1: about 1e-7
    step = floor.copy()
    step[:, 40:] *= 2
    assert depth_boundary(step)[:, 38:42].min() > 0.3
    step[:, 30:50] = 0  # unknown: no claim is made there
    assert depth_boundary(step)[:, 38:42].max() == 0


def plain_half_disc(codes, bins, radius, ordered):
    """Float64, one pixel and one direction at a time; the diameter belongs to its turned end."""
    H, W = codes.shape
    out = np.zeros((8, H, W))
    reach = range(-radius, radius + 1)
    offsets = [(dy, dx) for dy in reach for dx in reach if 0 < dy * dy + dx * dx <= radius**2 + 1]
    padded = np.pad(codes, radius, mode="reflect")
    for o, y, x in np.ndindex(out.shape):
        halves = np.zeros((2, bins))
        for dy, dx in offsets:
            turn = (np.arctan2(dy, dx) / np.pi * 8 + 1e-9 - o) % 16
            halves[int(turn >= 8), padded[y + dy + radius, x + dx + radius]] += 1
        if ordered:
            wide = np.pad(halves, ((0, 0), (1, 1)), mode="edge")
            halves = (wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]) / 4
        p, q = halves / halves.sum(1, keepdims=True)
        total = np.where(p + q > 0, p + q, 1)
        out[o, y, x] = 0.5 * ((p - q) ** 2 / total).sum()
    return out


def random_codes(seed):
    codes = np.random.default_rng(seed).integers(0, 5, (11, 13)).astype(np.uint8)
    codes[:, 6:] = np.minimum(codes[:, 6:] + 3, 4)
    return codes


def steep_codes(seed):
    """Neighbouring discs with different codes: counts of one must not remain in the next."""
    rng = np.random.default_rng(seed)
    return (3 * rng.integers(0, 7, (11, 1)) + rng.integers(0, 2, (11, 17))).astype(np.uint8)


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("radius", [1, 3, 4, 6])
@pytest.mark.parametrize(("make", "bins"), [(random_codes, 5), (steep_codes, 20)])
def test_half_disc_equals_the_plain_reference(make, bins, radius, ordered):
    codes = make(radius)
    fast = half_disc(codes, bins, radius, ordered)
    # Sums of tens of float32 terms of order 0.1: the noise is about 1e-6.
    np.testing.assert_allclose(fast, plain_half_disc(codes, bins, radius, ordered), atol=5e-6)


def test_boundary_map_is_the_greatest_sum_of_its_cues():
    """A photograph of random patches, in float64; SciPy's blur and an area mean of 2x2 pixels."""
    rng = np.random.default_rng(5)
    lab = np.kron(rng.uniform((20, -40, -40), (90, 40, 40), (5, 6, 3)), np.ones((4, 4, 1)))
    lab = lab.astype(np.float32)
    small = lab.reshape(10, 2, 12, 2, 3).mean((1, 3))
    cues = [
        (tone_codes(small)[..., k], 20, *cue) for k, cue in enumerate([(3, 0.3), *[(4, 0.45)] * 2])
    ]
    wide = sum(
        weight * plain_half_disc(codes, bins, radius, True) for codes, bins, radius, weight in cues
    )
    texture = texture_codes(lab[..., 0])[::2, ::2]
    wide += 0.25 * plain_half_disc(texture, 27, 6, False)
    fine = 0.3 * plain_half_disc(tone_codes(lab)[..., 0], 20, 3, True)
    total = [
        ndimage.gaussian_filter(a + cv2.resize(b, (24, 20)), 0.8, mode="mirror", radius=3)
        for a, b in zip(fine, wide, strict=True)
    ]
    np.testing.assert_allclose(boundary_map(lab), np.max(total, 0), atol=2e-5)


def test_depth_boundary_of_a_jump_is_blurred_and_at_most_half():
    depth = np.full((20, 40), 1.0, np.float32)
    depth[:, 20:] = 1.3
    bend = np.zeros((20, 40))
    bend[:, 17:20], bend[:, 20:23] = 1 - 1 / 1.3, 1.3 - 1  # relative to inverse depth there
    wanted = np.minimum(ndimage.gaussian_filter(bend, 1.0, mode="mirror", radius=4), 0.5)
    np.testing.assert_allclose(depth_boundary(depth), wanted, atol=1e-4)


@pytest.mark.parametrize("degrees", [0, 45, 90, 135])
@pytest.mark.parametrize(("step", "level"), [(0, 0), (10, 1), (60, 2)])
def test_texture_codes_hold_direction_and_strength_of_an_edge(degrees, step, level):
    y, x = np.mgrid[-15:16, -15:16]
    across = x * np.cos(np.radians(degrees)) + y * np.sin(np.radians(degrees))
    code = texture_codes((30 + step * (across > 0)).astype(np.float32))[15, 15]
    assert code // 3 == (0 if level == 0 else 1 + 4 * (level - 1) + degrees // 45)
