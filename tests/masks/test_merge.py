import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.geometry import SeenView
from slgaussian.masks.merge import (
    Cues,
    MergeTree,
    _plane_error,
    build_tree,
    joint_sums,
    leaf_sums,
    plane_gap,
    plane_sums,
)

# Written out, not imported: a slip in the module must show here.
COLOUR_STEP, PLANE_STEP = 30.0, 0.05


def drawn_tree(draw):
    """Any merge tree, or forest, over a row of leaves of a few pixels each."""
    count = draw(st.integers(1, 12))
    sizes = draw(st.lists(st.integers(1, 5), min_size=count, max_size=count))
    leaves = np.repeat(np.arange(count, dtype=np.int32), sizes)[None]
    parent, height, live = [-1] * count, [0.0] * count, list(range(count))
    for _ in range(draw(st.integers(0, count - 1))):
        pair = [live.pop(draw(st.integers(0, len(live) - 1))) for _ in range(2)]
        for node in pair:
            parent[node] = len(parent)
        live.append(len(parent))
        parent.append(-1)
        height.append(height[-1] + draw(st.sampled_from([0.0, 0.5, 1.0])))
    return MergeTree(leaves, np.array(parent, np.int32), np.array(height))


trees = st.composite(drawn_tree)()


def members_by_walking(tree):
    """The leaves below every node, found by walking up from each leaf."""
    out = np.zeros((len(tree.parent), tree.leaves.max() + 1), bool)
    for leaf in range(out.shape[1]):
        node = leaf
        while node >= 0:
            out[node, leaf] = True
            node = tree.parent[node]
    return out


@given(trees, st.integers(0, 12))
def test_places_and_labels_name_node_of_cut_above_each_leaf(tree, maximum):
    nodes = tree.cut(0.6, maximum)
    np.testing.assert_array_equal(tree.places(nodes), members_by_walking(tree)[nodes].argmax(0))
    np.testing.assert_array_equal(tree.labels(nodes), tree.places(nodes)[tree.leaves] + 1)


@given(trees)
def test_members_of_node_are_the_leaves_below_it(tree):
    expected = members_by_walking(tree)
    np.testing.assert_array_equal(tree.members(), expected)
    shared = expected[:, None] & expected
    nested = (shared == expected[:, None]).all(2) | (shared == expected).all(2)
    assert (nested | ~shared.any(2)).all()


@pytest.fixture(scope="module")
def noise():
    """Six leaves of noise, some depth unknown: CIELAB, leaves, boundary, depth."""
    rng = np.random.default_rng(4)
    leaves = np.repeat(np.repeat(np.arange(6, dtype=np.int32).reshape(2, 3), 9, 0), 8, 1)
    leaves[7:11] = np.roll(leaves[7:11], 2, 1)
    image = rng.integers(0, 256, (*leaves.shape, 3)).astype(np.uint8)
    image[leaves % 2 == 0] //= 3
    boundary = rng.uniform(0, 1, leaves.shape).astype(np.float32)
    depth = rng.uniform(2, 3, leaves.shape).astype(np.float32)
    depth[:5, :12] = 0
    return SeenView.alone(image).view.lab, leaves, boundary, depth


def plain_cost(a, b, sums, cues):
    """Cost of uniting two lists of leaves, from their sums, one term at a time."""
    between = [(u in a and v in b) or (u in b and v in a) for u, v in sums.edges]
    if not any(between):
        return np.inf
    sizes = [sums.means[leaves, 0].sum() for leaves in (a, b)]
    means = [sums.means[leaves].sum(0) for leaves in (a, b)]
    colour, (p, q) = ([mean[part] / mean[0] for mean in means] for part in (np.s_[1:4], np.s_[4:]))
    used = p + q > 0
    misfits, empty = [], []
    for view in range(sums.views.shape[1]):
        visible = [sums.views[leaves, view, 0].sum() for leaves in (a, b)]
        if all(visible):
            gap = plane_gap(*(sums.views[leaves, view, 1:].sum(0) for leaves in (a, b)))
            misfits.append(min(gap / PLANE_STEP, 1))
        if any(visible):
            corners = sums.boxes[a + b, view]
            extent = corners[:, 2:].max(0) - corners[:, :2].min(0)
            empty.append(1 - sum(visible) / extent.prod())
    terms = [
        (1.0, np.divide(*sums.borders[between].sum(0)[::-1])),
        (cues.colour, min(np.linalg.norm(colour[0] - colour[1]) / COLOUR_STEP, 1)),
        (cues.texture, ((p - q)[used] ** 2 / (p + q)[used]).sum()),
        (cues.plane, np.mean(misfits) if misfits else 0),
        (cues.fill, np.mean(empty)),
    ]
    return (
        sum(weight * term for weight, term in terms)
        * (sizes[0] * sizes[1] / sum(sizes)) ** cues.size_power
    )


@pytest.mark.parametrize("cues", [Cues(), Cues(0.1, 0.4, 0.3, 0.5, 0.1)])
def test_build_tree_equals_plain_greedy_merging(noise, cues):
    """One view turned round, with a leaf that it does not show, and one without depth."""
    image, leaves, boundary, depth = noise
    check_merging(leaf_sums(image, leaves, boundary), cues)
    check_merging(leaf_sums(image, leaves, boundary, depth), cues)
    hidden = np.where(leaves == 4, 1, leaves)[::-1].copy()
    bare = np.where(leaves == 0, -1, leaves)
    views = [
        leaf_sums(image, leaves, boundary, depth, 6),
        leaf_sums(image[::-1].copy(), hidden, boundary, depth, 6),
        leaf_sums(image[:, ::-1].copy(), bare, boundary[::-1], None, 6),
    ]
    joint = joint_sums(views)
    assert joint.views.shape == (6, 3, 11) and joint.views[4, 1, 0] == joint.views[0, 2, 0] == 0
    check_merging(joint, cues)


def check_merging(sums, cues):
    """A tree over six leaves against one that is built from costs worked out anew each time."""
    tree = build_tree(sums, cues)
    live = {node: [node] for node in range(6)}
    sets, height = dict(live), [0.0] * 6
    while len(live) > 1:
        pairs = [(a, b) for a in live for b in live if a < b]
        costs = [plain_cost(live[a], live[b], sums, cues) for a, b in pairs]
        a, b = pairs[int(np.argmin(costs))]
        height.append(max(min(costs), height[a], height[b]))
        live[len(height) - 1] = sets[len(height) - 1] = live.pop(a) + live.pop(b)
    np.testing.assert_allclose(tree.height, height, rtol=1e-9)  # the order of sums: 1e-15
    members = tree.members()
    result = [np.flatnonzero(row).tolist() for row in members]
    assert result == [sorted(sets[node]) for node in range(len(height))]


def test_plane_error_equals_least_squares():
    rng = np.random.default_rng(5)
    leaves = rng.integers(0, 3, (20, 30)).astype(np.int32)
    depth = rng.uniform(1, 3, leaves.shape).astype(np.float32)
    sums = plane_sums(leaves, depth, 3)

    def residual(inside):
        v, u = np.nonzero(inside)
        d = np.median(depth) / depth[inside].astype(np.float64)
        A = np.stack([np.ones(len(u)), u / 30, v / 30], 1)
        return pytest.approx(np.linalg.lstsq(A, d, rcond=None)[1][0], rel=1e-4)  # a ridge of 1e-6

    for leaf in range(3):
        assert _plane_error(sums[leaf], sums[0], 0.0) == residual(leaves == leaf)
    assert _plane_error(sums[1], sums[2], 1.0) == residual(leaves > 0)
