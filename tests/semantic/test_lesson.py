"""Storage and validation of lessons."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drawn_lessons import SIZE, camera, lesson

from slgaussian.errors import InputError
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.store import ArtifactStore


def test_lesson_survives_storage(tmp_path):
    stored = lesson()
    first, second = stored.cameras
    cameras = (replace(first, near=0.5), replace(second, near=0.5, far=20.0))
    stored = replace(stored, cameras=cameras)
    store = ArtifactStore(tmp_path)
    restored = Lesson.from_arrays(store.get(store.put("lesson", stored.to_arrays())))
    assert restored.sample == stored.sample
    np.testing.assert_array_equal(restored.labels, stored.labels)
    np.testing.assert_array_equal(restored.targets, stored.targets)
    for name, values in stored.gaussians.items():
        assert torch.equal(dict(restored.gaussians.items())[name], values), name
    for actual, expected in zip(restored.cameras, cameras, strict=True):
        np.testing.assert_array_equal(actual.K, expected.K)
        np.testing.assert_array_equal(actual.c2w, expected.c2w)
        assert (actual.near, actual.far) == (expected.near, expected.far)
        assert actual.width == expected.width


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"targets": np.zeros((1, *SIZE), np.int32)}, "a target map for each camera"),
        ({"cameras": (camera(0), camera(0, (5, 5)))}, "all of the size of the labels"),
        ({"cameras": (), "targets": np.zeros((0, *SIZE), np.int32)}, "no target view"),
        ({"labels": np.zeros((1, *SIZE), np.int32)}, "pixels 0 to 767"),
    ],
)
def test_lesson_refuses_inconsistent_arrays_by_name(changes, message):
    with pytest.raises(InputError, match=f"lesson 'wall 0': found .*{message}"):
        replace(lesson(), **changes)
