"""Lessons say what is wrong with them, and come back as they were stored."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drawn_lessons import SIZE, camera, lesson

from slgaussian.errors import InputError
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.store import ArtifactStore


def test_a_lesson_comes_back_from_the_store_as_it_was(tmp_path):
    made = lesson()
    near = replace(made.cameras[0], near=0.5)
    made = replace(made, cameras=(near, replace(made.cameras[1], near=0.5, far=20.0)))
    store = ArtifactStore(tmp_path)
    back = Lesson.from_arrays(store.get(store.put("lesson", made.to_arrays())))
    assert back.sample == made.sample
    np.testing.assert_array_equal(back.labels, made.labels)
    np.testing.assert_array_equal(back.targets, made.targets)
    for (name, value), (_, other) in zip(
        made.gaussians.items(), back.gaussians.items(), strict=True
    ):
        assert torch.equal(value, other), name
    for mine, other in zip(made.cameras, back.cameras, strict=True):
        np.testing.assert_array_equal(mine.K, other.K)
        np.testing.assert_array_equal(mine.c2w, other.c2w)
        assert (mine.near, mine.far, mine.width) == (other.near, other.far, other.width)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"targets": np.zeros((1, *SIZE), np.int32)}, "a target map for each camera"),
        ({"cameras": (camera(0), camera(0, (5, 5)))}, "all of the size of the labels"),
        ({"cameras": (), "targets": np.zeros((0, *SIZE), np.int32)}, "no target view"),
        ({"labels": np.zeros((1, *SIZE), np.int32)}, "pixels 0 to 767"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_name_of_the_sample(wrong, message):
    with pytest.raises(InputError, match=f"lesson 'wall 0': found .*{message}"):
        replace(lesson(), **wrong)
