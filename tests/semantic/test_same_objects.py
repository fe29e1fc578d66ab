"""Ids that objects keep when a field is built anew of more photographs."""

import numpy as np
import pytest
import torch
from known import known_field

from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.labels import LabelMaps
from slgaussian.parts.method import Method
from slgaussian.scene import Camera, Sample, View
from slgaussian.semantic.same_objects import with_ids_of

SIZE = 32, 48
COLOURS = np.array([[200, 20, 20], [20, 20, 200], [20, 160, 20], [230, 220, 40]], np.uint8)
DEPTH = 2.0


def striped(names, stripes, codes):
    """A wall of four stripes, seen by cameras of these names; a row of ids of stripes for each."""
    height, width = SIZE
    K = np.array([[40.0, 0, 24], [0, 40, 16], [0, 0, 1]])
    views, labels, points = [], [], []
    column = np.arange(width) * 4 // width
    for k, (name, ids) in enumerate(zip(names, stripes, strict=True)):
        c2w = np.eye(4)
        c2w[0, 3] = 0.05 * k
        camera = Camera(K, c2w, width, height)
        image = np.broadcast_to(COLOURS[column], (height, width, 3)).copy()
        image[0, 0] = k  # no two photographs are one
        views.append(View(name, camera, image))
        labels.append(np.broadcast_to(np.array(ids, np.int32)[column], SIZE))
        points.append(camera.unproject(np.full(SIZE, DEPTH)).reshape(-1, 3))
    means = torch.tensor(np.concatenate(points), dtype=torch.float32)
    n = len(means)
    gaussians = Gaussians(
        means,
        torch.full((n, 3), 0.03),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.full((n,), 0.9),
        rgb_to_sh(torch.full((n, 3), 0.5)),
        torch.arange(n, dtype=torch.int32),
    )
    maps = LabelMaps(np.stack(labels), np.ones((len(labels), *SIZE), np.float32))
    return known_field(
        Sample("wall", tuple(views)), gaussians, maps, Method(codes=codes, keep="all")
    )


@pytest.mark.parametrize("codes", ["grid", "exact"])
def test_objects_keep_their_ids_and_new_ones_come_after(codes):
    before = striped("ab", [[1, 2, 3, 9], [1, 2, 3, 9]], codes)
    # The views are called otherwise, and one stands between them; two stripes have become one.
    after = striped("xyz", [[3, 1, 1, 2], [4, 4, 4, 4], [3, 1, 1, 2]], codes)
    kept = with_ids_of(before, after, {"a": "x", "b": "z"})
    assert kept.bank.ids.tolist() == [1, 2, 9, 10]
    expected = np.array([0, 2, 9, 1, 10])  # of the ids 1 to 4 in `after`
    np.testing.assert_array_equal(kept.labels(), expected[after.labels()])
    for old, new in enumerate(expected[1:], 1):
        a, b = np.searchsorted(after.bank.ids, old), np.searchsorted(kept.bank.ids, new)
        for name in ("codes", "features", "present", "boxes"):
            np.testing.assert_array_equal(getattr(kept.bank, name)[b], getattr(after.bank, name)[a])
    camera = after.cameras["x"]
    seen, shown = after.render(camera).ids, kept.render(camera).ids
    np.testing.assert_array_equal(shown, expected[seen])
    assert kept.cameras == after.cameras


def test_a_border_that_moved_is_no_object():
    before = striped("ab", [[1, 1, 1, 0], [1, 1, 1, 0]], "grid")
    after = striped("ab", [[0, 0, 7, 8], [0, 0, 0, 8]], "grid")
    kept = with_ids_of(before, after, {"a": "a", "b": "b"})
    assert set(kept.bank.ids.tolist()) == {1, 2}  # a piece of it is it still, and 8 was not there
    np.testing.assert_array_equal(kept.labels() == 2, after.labels() == 8)


def test_groups_stay_with_their_objects():
    field = striped("ab", [[5, 6, 7, 8], [5, 6, 7, 8]], "grid")
    turned = striped("ab", [[4, 3, 2, 1], [4, 3, 2, 1]], "grid")
    kept = with_ids_of(field, turned, {"a": "a", "b": "b"})
    assert kept.bank.ids.tolist() == [5, 6, 7, 8]
    own = turned.bank.levels[:, ::-1]
    grouped = own >= 4
    np.testing.assert_array_equal(kept.bank.levels[grouped], own[grouped])
    rows = np.broadcast_to(np.arange(4), own.shape)
    np.testing.assert_array_equal(kept.bank.levels[~grouped], rows[~grouped])
