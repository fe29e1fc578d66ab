import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.datasets.configs import Rule
from slgaussian.datasets.pair_selection import Views, surround
from slgaussian.scene import Camera
from tests.datasets.plain_overlap import shared_view

DEPTH = 3.0


def camera(place, turn: float = 0.0) -> Camera:
    c2w = np.eye(4)
    a = np.radians(turn)
    c2w[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    c2w[:3, 3] = place
    return Camera(np.array([[80, 0, 48], [0, 80, 32], [0, 0, 1.0]]), c2w, 96, 64)


def views(cameras, depth=DEPTH, blur=0.3) -> Views:
    n = len(cameras)
    return Views(
        cameras,
        np.broadcast_to(np.asarray(depth, float), n).copy(),
        np.broadcast_to(np.asarray(blur, float), n).copy(),
        np.full(n, 0.5),
        np.zeros(n),
    )


def path(n=21, step=0.1):
    """Cameras along a line, all looking ahead."""
    return [camera((step * i, 0, 0)) for i in range(n)]


def plain(clip: Views, target: int, barred, rule: Rule):
    """The best pair by the rule, written out one pair after the other."""
    best = None
    for a in range(len(clip.cameras)):
        for b in range(a + 1, len(clip.cameras)):
            if {a, b} & {target, *barred} or not clip.usable(rule)[[a, b]].all():
                continue
            one, two, aim = clip.cameras[a], clip.cameras[b], clip.cameras[target]
            shared = min(
                shared_view(one, two, clip.depths[a]), shared_view(two, one, clip.depths[b])
            )
            apart = float(np.linalg.norm(one.center - two.center))
            baseline = apart / (clip.depths[a] + clip.depths[b]) * 2
            low, high = rule.min_overlap, rule.max_overlap
            if not (low <= shared <= high and apart > 0):
                continue
            if not rule.min_baseline <= baseline <= rule.max_baseline:
                continue
            aside = float(np.linalg.norm((one.center + two.center) / 2 - aim.center)) / apart
            grid = [(x, y) for y in range(9) for x in range(9)]
            seen = 0
            for x, y in grid:
                pixel = np.array([(x + 0.5) / 9 * aim.width, (y + 0.5) / 9 * aim.height, 1])
                ray = aim.c2w[:3, :3] @ (np.linalg.inv(aim.K) @ pixel) * clip.depths[target]
                for eye in (one, two):
                    (u, v), z = eye.project(aim.center + ray)
                    if z > 0 and 0 <= u < eye.width and 0 <= v < eye.height:
                        seen += 1
                        break
            cover = seen / len(grid)
            if aside > rule.max_aside or cover < rule.min_cover:
                continue
            central = 1 - 0.5 * abs(shared - (low + high) / 2) / ((high - low) / 2)
            worst = (max(clip.blur[a], clip.blur[b]) - np.median(clip.blur)) / rule.max_blur
            value = central * (1 - 0.5 * min(max(worst, 0), 1)) * cover
            value *= 1 - 0.5 * aside / rule.max_aside
            if best is None or value > best[0] + 1e-12:
                best = value, (a, b)
    return best


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**16), unordered=st.booleans())
def test_the_pair_is_the_best_of_a_plain_search(seed, unordered):
    rng = np.random.default_rng(seed)
    cameras = [camera((0.1 * i, 0, 0) + rng.normal(0, 0.08, 3), rng.normal(0, 6)) for i in range(9)]
    if unordered:
        cameras = [cameras[i] for i in rng.permutation(9)]
    clip = views(cameras, rng.uniform(2, 4, 9), rng.uniform(0.2, 0.5, 9))
    targets, barred = [3, 6], {5}
    rule = Rule(min_cover=0.8, max_aside=0.4)
    for target, found in zip(targets, surround(clip, targets, barred, rule), strict=True):
        best = plain(clip, target, {*targets, *barred}, rule)
        if best is None:
            assert "have it between them" in found
        else:
            assert found.pair.score == pytest.approx(best[0], rel=1e-9)
            assert found.pair.context == best[1]
            assert found.pair.targets == (target,)


@pytest.mark.parametrize(
    ("clip", "reason"),
    [
        (views(path(), depth=np.nan), "no parallax"),
        (views(path(2)), "0 of 2 views are sharp"),
        (views([camera((0, 0, 0))] * 5), "0 pairs of views fit"),
        (views(path()[:11]), "0 of them have it between them"),
        (views([*path()[:10], camera((1, 0, 0), 60), *path()[11:]]), "none sees 0.9 of it"),
    ],
)
def test_without_a_pair_the_reason_is_said(clip, reason):
    target = min(10, len(clip.cameras) - 1)
    barred = {0} if len(clip.cameras) == 2 else set()
    (found,) = surround(clip, [target], barred, Rule())
    assert reason in found
