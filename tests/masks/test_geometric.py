from functools import cache

import numpy as np
import pytest
from drawn_views import canvas, paste, with_depths

from slgaussian.datasets.procedural import reader
from slgaussian.errors import InputError
from slgaussian.geometry import SeenView
from slgaussian.masks import geometric, load_tracker
from slgaussian.masks.shared import SurfacePoints, reproject
from slgaussian.scene import Camera, View

# Written out, not imported: a slip in the module must show here.
AGREE_PIXELS = 4.0

SIZE = (96, 128)


@cache
def room(baseline=0.6, seed=3):
    scene = reader.read(seed=seed, height=208, width=288, views=2, baseline=baseline)
    return [scene.read(name) for name in scene.cameras]


def propagate_labels(old, new, depths):
    tracker = load_tracker("geometric")
    tracker.add(SeenView(old, depths[0]), old.instances)
    return tracker.propagate(SeenView(new, depths[1]))


@pytest.mark.parametrize("baseline", [0.6, 1.6])
@pytest.mark.parametrize("swapped", [False, True])
def test_propagate_labels_same_objects_at_short_and_long_baseline(baseline, swapped):
    old, new = room(baseline)[:: -1 if swapped else 1]
    labels = propagate_labels(old, new, [old.depth, new.depth])
    valid = labels > 0
    assert valid.mean() > 0.9
    assert (labels == new.instances)[valid].mean() > 0.96
    both = np.intersect1d(old.instances, new.instances)
    right = [np.bincount(labels[new.instances == i]).argmax() == i for i in both]
    # Some are of a dozen pixels here, or wear the colour of what is behind them.
    assert len(both) >= 12 and np.mean(right) >= 0.75


def cameras(shift):
    K = np.array([[100, 0, SIZE[1] / 2], [0, 100, SIZE[0] / 2], [0, 0, 1.0]])
    c2w = np.eye(4)
    c2w[0, 3] = shift
    return [Camera(K, pose, SIZE[1], SIZE[0]) for pose in (np.eye(4), c2w)]


def screen_and_wall(shift=0.4):
    """Two views of a wall at depth 4 and a screen before it at depth 2, and their depths."""
    views, depths = [], []
    for index, (camera, (left, wall)) in enumerate(
        zip(
            cameras(shift),
            [(50, 0), (50 - round(100 * shift / 2), round(100 * shift / 4))],
            strict=True,
        )
    ):
        large = np.tile(canvas((120, 130, 140), seed=1), (1, 2, 1))
        picture = large[: SIZE[0], wall : wall + SIZE[1]].copy()
        paste(picture, (30, 70, left, left + 30), (200, 60, 40), 5)
        depth = np.full(SIZE, 4, np.float32)
        depth[30:70, left : left + 30] = 2
        image = np.clip(picture, 0, 255).astype(np.uint8)
        views.append(View(f"{index}", camera, image))
        depths.append(depth)
    return views, depths


def test_reproject_equals_pixel_by_pixel_reprojection():
    """Reproject pixel by pixel, forward and backward, and measure the distance."""
    (a, b), depths = screen_and_wall(0.37)
    rng = np.random.default_rng(0)
    depths = [(d * rng.uniform(0.93, 1.07, d.shape)).astype(np.float32) for d in depths]
    depths[0][5:9, 5:50] = depths[1][:20, 60:80] = 0
    new, old = (SurfacePoints(frame) for frame in with_depths((b, a), depths[::-1]))
    which, is_inside = reproject(new, old, new.pixels(1))
    place = np.full(SIZE, -1)
    place.ravel()[new.pixels(1)[which]] = is_inside

    def reproject_pixel(row, column, depth, here, inside):
        ray = np.linalg.inv(here.K) @ (column + 0.5, row + 0.5, 1)
        point = inside.w2c @ np.append(here.c2w[:3, :3] @ ray * float(depth) + here.center, 1)
        pixel = inside.K @ point[:3]
        return pixel[:2] / pixel[2] - 0.5

    checked = 0
    for row, column in np.ndindex(SIZE):
        result = None
        if depths[1][row, column] > 0:
            x, y = reproject_pixel(row, column, depths[1][row, column], b.camera, a.camera)
            i, j = round(y), round(x)
            if 0 <= i < SIZE[0] and 0 <= j < SIZE[1] and depths[0][i, j] > 0:
                back = reproject_pixel(i, j, depths[0][i, j], a.camera, b.camera)
                error = np.hypot(*(back - (column, row)))
                if (
                    abs(error - AGREE_PIXELS) < 1e-6
                    or min(abs(x % 1 - 0.5), abs(y % 1 - 0.5)) < 1e-6
                ):
                    continue
                result = i * SIZE[1] + j if error <= AGREE_PIXELS else None
        assert place[row, column] == (-1 if result is None else result)
        checked += 1
    assert checked > 0.99 * SIZE[0] * SIZE[1]
    assert 0.3 < (place >= 0).mean() < 0.9


def test_propagate_refuses_view_without_depth():
    old, new = room()
    with pytest.raises(InputError, match="found no predicted depth"):
        propagate_labels(old, new, [None, None])


def test_propagate_matches_only_frames_of_greatest_overlap(monkeypatch):
    scene = reader.read(seed=3, height=104, width=144, views=10, baseline=2.0)
    views = [scene.read(each) for each in scene.cameras]
    tracker, calls = load_tracker("geometric"), []
    match = geometric.match_points
    monkeypatch.setattr(
        geometric,
        "match_points",
        lambda new, old, pixels: calls.append(old.frame.view.name) or match(new, old, pixels),
    )
    for each in views[:9]:
        tracker.add(SeenView(each, each.depth), each.instances)
    labels = tracker.propagate(SeenView(views[9], views[9].depth))
    assert calls == [f"view_{k:02d}" for k in range(3, 9)]
    valid = labels > 0
    assert (labels == views[9].instances)[valid].mean() > 0.9
