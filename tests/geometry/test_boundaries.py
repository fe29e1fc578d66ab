import numpy as np
import pytest

from slgaussian.geometry.boundaries import depth_boundary, half_disc


def test_a_slanted_plane_is_no_border():
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


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("radius", [3, 4, 6])
def test_half_disc_equals_its_plain_reference(radius, ordered):
    rng = np.random.default_rng(radius)
    codes = rng.integers(0, 5, (11, 13)).astype(np.uint8)
    codes[:, 6:] = np.minimum(codes[:, 6:] + 3, 4)
    fast = half_disc(codes, 5, radius, ordered)
    # Sums of tens of float32 terms of order 0.1: the noise is about 1e-6.
    np.testing.assert_allclose(fast, plain_half_disc(codes, 5, radius, ordered), atol=5e-6)


def test_half_disc_of_two_halves_is_strongest_along_their_border():
    codes = np.zeros((20, 20), np.uint8)
    codes[:, 10:] = 1
    strength = half_disc(codes, 2, 4, ordered=False)
    assert strength.argmax(0)[10, 10] == 4  # the vertical diameter
    assert strength[:, 10, 2].max() == 0
