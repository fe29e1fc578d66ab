"""Selection of view pairs along a clip and around targets, against plain searches."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slgaussian.datasets.configs import Bounds, Rule
from slgaussian.datasets.pair_selection import Pair, Views, choose, overlaps, schedule, surround
from slgaussian.errors import InputError
from slgaussian.scene import Camera

K = np.array([[80.0, 0, 48], [0, 80, 32], [0, 0, 1]])


def camera(x=0.0, turn=0.0, z=0.0):
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_euler("y", turn, degrees=True).as_matrix()
    c2w[:3, 3] = x, 0, z
    return Camera(K, c2w, 96, 64)


def walk(count=20, step=0.1, turns=None, depth=4.0):
    """Cameras that step sideways along a wall."""
    turns = np.zeros(count) if turns is None else turns
    cameras = [camera(step * i, turns[i]) for i in range(count)]
    ones = np.ones(count)
    return Views(cameras, depth * ones, 0.4 * ones, 0.5 * ones, 0 * ones)


def visible(a: Camera, b: Camera, depth: float) -> np.ndarray:
    """Mask [81] of the points of a grid over image ``a``, at a depth, that project into ``b``."""
    n = 9
    u, v = np.meshgrid((np.arange(n) + 0.5) / n * a.width, (np.arange(n) + 0.5) / n * a.height)
    local = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3) @ np.linalg.inv(a.K).T
    return b.shows(*b.project(a.center + depth * local @ a.c2w[:3, :3].T))


def mutual_overlap(clip: Views, a: int, b: int) -> float:
    pairs = (a, b), (b, a)
    return min(visible(clip.cameras[i], clip.cameras[j], clip.depths[i]).mean() for i, j in pairs)


def test_chosen_pairs_keep_the_bounds_and_share_no_frame():
    views, bounds = walk(40), Bounds()
    for frame, (name, value) in {3: ("blur", 0.7), 5: ("mean", 0.99), 8: ("clipped", 0.6)}.items():
        getattr(views, name)[frame] = value
    pairs = choose(views, bounds)
    assert len(pairs) > 2
    frames = [frame for pair in pairs for frame in (*pair.context, *pair.targets)]
    assert len(set(frames)) == len(frames) and not {3, 5, 8} & set(frames)
    ends = [end for pair in pairs for end in pair.context]
    assert ends == sorted(ends)
    for pair in pairs:
        a, b = pair.context
        assert a < pair.targets[0] < pair.targets[1] < pair.targets[2] < b
        overlap = mutual_overlap(views, a, b)
        baseline = np.linalg.norm(views.cameras[a].center - views.cameras[b].center) / 4
        assert pair.overlap == pytest.approx(overlap) and pair.baseline == pytest.approx(baseline)
        assert bounds.min_overlap <= overlap <= bounds.max_overlap
        assert bounds.min_baseline <= baseline <= bounds.max_baseline
    assert choose(views, bounds) == pairs
    assert choose(views, bounds.model_copy(update={"most": 2})) == sorted(
        sorted(pairs, key=lambda pair: -pair.score)[:2], key=lambda pair: pair.context
    )


def test_overlaps_equal_a_plain_search():
    rng = np.random.default_rng(3)
    cameras = [camera(x, t, z) for x, t, z in rng.uniform((-1, -60, -5), (1, 60, 5), (9, 3))] + [
        camera(turn=180)
    ]
    depths = rng.uniform(1, 6, len(cameras))
    rows = zip(cameras, depths, strict=True)
    expected = [[visible(a, b, depth).mean() for b in cameras] for a, depth in rows]
    np.testing.assert_array_equal(overlaps(cameras, depths), expected)


intervals = st.tuples(st.integers(0, 15), st.integers(1, 8), st.floats(0.01, 1))


@settings(max_examples=60, deadline=None)
@given(st.lists(intervals, max_size=9))
def test_schedule_has_the_highest_score_of_all_choices(spans):
    pairs = [Pair((a, a + n), (), 0, 0, 0, score) for a, n, score in spans]

    def disjoint(choice):
        spans = sorted(pair.context for pair in choice)
        return all(a[1] < b[0] for a, b in pairwise(spans))

    best = max(
        sum(pair.score for pair in choice)
        for count in range(len(pairs) + 1)
        for choice in combinations(pairs, count)
        if disjoint(choice)
    )
    scheduled = schedule(pairs)
    assert disjoint(scheduled)
    assert sum(pair.score for pair in scheduled) == pytest.approx(best)


def test_choose_explains_clip_without_a_pair():
    with pytest.raises(InputError, match=r"4 of its 4 views are sharp .* too few for a sample"):
        choose(walk(4), Bounds())
    still = walk(9, step=1e-3)
    with pytest.raises(InputError, match=r"baseline of 0.08 to 0.4 .* baselines up to 0.00"):
        choose(still, Bounds())
    for narrow in (Bounds(min_overlap=0.95), Bounds(max_overlap=0.65, max_baseline=0.1)):
        with pytest.raises(InputError, match=f"overlap of {narrow.min_overlap} to "):
            choose(walk(40), narrow)
    with pytest.raises(InputError, match="no parallax"):
        choose(replace(still, depths=np.full(9, np.nan)), Bounds())


def best_pair(clip: Views, target: int, barred, rule: Rule):
    """Search all pairs for the best by the rule: its score, views, cover and distance aside."""
    best = None
    usable = [i for i in range(len(clip.cameras)) if clip.usable(rule)[i]]
    for a, b in combinations([i for i in usable if i not in (target, *barred)], 2):
        first, second, aim = (clip.cameras[i] for i in (a, b, target))
        overlap = mutual_overlap(clip, a, b)
        distance = float(np.linalg.norm(first.center - second.center))
        baseline = distance / (clip.depths[a] + clip.depths[b]) * 2
        low, high = rule.min_overlap, rule.max_overlap
        aside = float(np.linalg.norm((first.center + second.center) / 2 - aim.center)) / distance
        by_either = (visible(aim, eye, clip.depths[target]) for eye in (first, second))
        cover = np.logical_or(*by_either).mean()
        fits = low <= overlap <= high and rule.min_baseline <= baseline <= rule.max_baseline
        if not fits or aside > rule.max_aside or cover < rule.min_cover:
            continue
        central = 1 - 0.5 * abs(overlap - (low + high) / 2) / ((high - low) / 2)
        worst = (max(clip.blur[a], clip.blur[b]) - np.median(clip.blur)) / rule.max_blur
        value = central * (1 - 0.5 * min(max(worst, 0), 1)) * cover
        value *= 1 - 0.5 * aside / rule.max_aside
        if best is None or value > best[0] + 1e-12:
            best = value, (a, b), cover, aside
    return best


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**16), unordered=st.booleans())
def test_surrounding_pair_is_the_best_of_a_plain_search(seed, unordered):
    rng = np.random.default_rng(seed)
    cameras = [
        camera(0.1 * i + rng.normal(0, 0.08), rng.normal(0, 6), rng.normal(0, 0.08))
        for i in range(9)
    ]
    if unordered:
        cameras = [cameras[i] for i in rng.permutation(9)]
    clip = replace(
        walk(9), cameras=cameras, depths=rng.uniform(2, 4, 9), blur=rng.uniform(0.2, 0.5, 9)
    )
    targets, barred = [3, 6], {5}
    rule = Rule(min_cover=0.8, max_aside=0.4)
    for target, pair in zip(targets, surround(clip, targets, barred, rule), strict=True):
        best = best_pair(clip, target, {*targets, *barred}, rule)
        if best is None:
            assert "have it between them" in pair
        else:
            assert (pair.context, pair.targets) == (best[1], (target,))
            measures = (pair.score, pair.cover, pair.aside)
            assert measures == pytest.approx((best[0], *best[2:]), rel=1e-9)


@pytest.mark.parametrize(
    ("clip", "reason"),
    [
        (walk(21, depth=np.nan), "no parallax"),
        (walk(2), "0 of 2 views are sharp"),
        (walk(5, step=0), "0 pairs of views fit"),
        (walk(11), "0 of them have it between them"),
        (walk(21, turns=60 * (np.arange(21) == 10)), "none sees 0.9 of it"),
    ],
)
def test_target_without_a_surrounding_pair_gets_a_reason(clip, reason):
    target = min(10, len(clip.cameras) - 1)
    barred = {0} if len(clip.cameras) == 2 else set()
    (result,) = surround(clip, [target], barred, Rule())
    assert reason in result
