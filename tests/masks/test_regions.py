import numba
import numpy as np
import pytest
from drawn_views import SIZE, canvas, main_label, paste, view

from slgaussian.errors import InputError
from slgaussian.masks.boundaries import depth_boundary, half_disc
from slgaussian.masks.flatten import flatten
from slgaussian.masks.merge import _plane_error, build_tree, plane_sums
from slgaussian.masks.regions import Regions, grow_tree

BALL = (30, 70, 20, 60)
BOX = (50, 100, 90, 140)


@pytest.fixture(scope="module")
def scene():
    picture = canvas((150, 150, 150), contrast=4)
    paste(picture, BALL, (200, 40, 40))
    paste(picture, BOX, (40, 60, 190), seed=3)
    return view(picture).image


def iou(mask, box):
    truth = np.zeros(mask.shape, bool)
    truth[box[0] : box[1], box[2] : box[3]] = True
    return (mask & truth).sum() / (mask | truth).sum()


def test_finds_each_object_as_one_region(scene):
    proposals = Regions().propose(scene)
    assert max(iou(mask, BALL) for mask in proposals.masks) > 0.9
    assert max(iou(mask, BOX) for mask in proposals.masks) > 0.9


def test_masks_are_disjoint_cover_the_image_and_are_scored(scene):
    proposals = Regions().propose(scene)
    assert (proposals.masks.sum(0) == 1).all()
    assert proposals.masks.any((1, 2)).all()
    assert proposals.scores.dtype == np.float32
    assert (proposals.scores >= 0).all() and (proposals.scores <= 1).all()


def test_most_bounds_the_number_of_regions(scene):
    assert len(Regions(height=0.0, most=7).propose(scene).masks) <= 7
    assert len(Regions(height=100.0).propose(scene).masks) == 1


def test_where_limits_the_search(scene):
    where = np.zeros(SIZE, bool)
    where[:, 80:] = True
    proposals = Regions().propose(scene, where=where)
    np.testing.assert_array_equal(proposals.masks.any(0), where)
    nothing = Regions().propose(scene, where=np.zeros(SIZE, bool))
    assert nothing.masks.shape == (0, *SIZE) and nothing.scores.shape == (0,)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 2), (37, 51)])
@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_blank_image_is_one_region(size, value):
    proposals = Regions().propose(np.full((*size, 3), value, np.uint8))
    assert proposals.masks.shape == (1, *size) and proposals.masks.all()


def test_depth_parts_what_colour_cannot():
    image = view(canvas((130, 130, 130), contrast=2)).image
    depth = np.full(SIZE, 4.0, np.float32)
    depth[40:90, 50:110] = 2.0
    flat = flatten(Regions().propose(image))
    assert main_label(flat, (45, 85, 55, 105)) == main_label(flat, (0, 30, 0, 160))
    deep = Regions().propose(image, depth=depth)
    assert max(iou(mask, (40, 90, 50, 110)) for mask in deep.masks) > 0.85


def test_a_slanted_plane_is_no_border():
    rows = np.linspace(1, 0.2, 60)[:, None]  # inverse depth of a floor
    floor = (1 / np.repeat(rows, 80, 1)).astype(np.float32)
    assert depth_boundary(floor).max() < 1e-4  # float32 of inverse depth near 1: about 1e-7
    step = floor.copy()
    step[:, 40:] *= 2
    assert depth_boundary(step)[:, 38:42].min() > 0.3
    step[:, 30:50] = 0  # unknown: no claim is made there
    assert depth_boundary(step)[:, 38:42].max() == 0


def test_same_bytes_whatever_the_number_of_threads(scene):
    before = numba.get_num_threads()
    expected = Regions().propose(scene)
    try:
        numba.set_num_threads(1)
        alone = Regions().propose(scene)
    finally:
        numba.set_num_threads(before)
    assert alone.masks.tobytes() == expected.masks.tobytes()
    assert alone.scores.tobytes() == expected.scores.tobytes()


@pytest.mark.parametrize(
    ("image", "extra", "says"),
    [
        (np.zeros((4, 4), np.uint8), {}, "expected uint8"),
        (np.zeros((4, 4, 3), np.float32), {}, "expected uint8"),
        (np.zeros((0, 4, 3), np.uint8), {}, "expected uint8"),
        (np.zeros((4, 4, 3), np.uint8), {"where": np.ones((4, 5), bool)}, "where"),
        (np.zeros((4, 4, 3), np.uint8), {"where": np.ones((4, 4))}, "where"),
        (np.zeros((4, 4, 3), np.uint8), {"depth": np.full((4, 4), np.nan)}, "NaN"),
    ],
)
def test_bad_input_is_refused(image, extra, says):
    with pytest.raises(InputError, match=says):
        Regions().propose(image, **extra)


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
@pytest.mark.parametrize("radius", [3, 4])
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


def test_plane_error_equals_least_squares():
    rng = np.random.default_rng(5)
    leaves = rng.integers(0, 3, (20, 30)).astype(np.int32)
    depth = rng.uniform(1, 3, leaves.shape).astype(np.float32)
    sums = plane_sums(leaves, depth, 3)
    for leaf in range(3):
        v, u = np.nonzero(leaves == leaf)
        d = np.median(depth) / depth[leaves == leaf].astype(np.float64)
        A = np.stack([np.ones(len(u)), u / 30, v / 30], 1)
        residual = np.linalg.lstsq(A, d, rcond=None)[1][0]
        assert _plane_error(sums[leaf]) == pytest.approx(residual, rel=1e-4)  # a ridge of 1e-6


def test_tree_heights_rise_and_every_cut_is_a_partition(scene):
    tree = grow_tree(scene)
    child = np.flatnonzero(tree.parent >= 0)
    assert (tree.parent[child] > child).all()
    assert (tree.height[tree.parent[child]] >= tree.height[child]).all()
    counts = []
    for height in (0.0, 0.1, 0.3, 1.0):
        nodes = tree.cut(height, most=10_000)
        labels = tree.labels(nodes)
        assert labels.min() == 1 and len(np.unique(labels)) == len(nodes)
        counts.append(len(nodes))
    assert counts == sorted(counts, reverse=True)


def test_the_cheapest_border_goes_first():
    image = np.zeros((6, 9, 3), np.uint8)
    image[:, :3], image[:, 3:6], image[:, 6:] = 200, 190, 20
    leaves = np.repeat(np.arange(3, dtype=np.int32), 3)[None].repeat(6, 0)
    tree = build_tree(image, leaves, np.zeros((6, 9), np.float32))
    assert tree.parent.tolist() == [3, 3, 4, 4, -1]
    assert 0 < tree.height[3] < tree.height[4]
