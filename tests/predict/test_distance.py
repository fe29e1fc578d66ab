"""Typical depths of a clip from sparse matches, compared with procedural rooms."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from slgaussian import datasets
from slgaussian.predict.distance import typical_depths
from tests.matching import sift_matches


@pytest.fixture(scope="module")
def room():
    scene = datasets.load("procedural", seed=4, views=6, height=144, width=256, baseline=0.8)
    views = [scene.read(name) for name in scene.cameras]
    greys = [cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY) for view in views]
    return greys, [view.camera for view in views], [view.depth for view in views]


def test_depths_are_those_of_what_is_matched(room):
    greys, cameras, truths = room
    result = typical_depths(greys, cameras)
    for index, (grey, truth) in enumerate(zip(greys, truths, strict=True)):
        second = index + 1 if index + 1 < len(greys) else index - 1
        column, row = sift_matches(grey, greys[second])[0].astype(int).T
        # Which points are matched depends on the other view: under 1 % here.
        assert result[index] == pytest.approx(np.median(truth[row, column]), rel=0.03)


def test_without_parallax_or_matches_nothing_is_known(room):
    greys, cameras, _ = room
    beside = replace(cameras[0], c2w=cameras[0].c2w + np.eye(4, k=3) * 0.1)
    assert np.isnan(typical_depths([greys[0]] * 2, [cameras[0], beside])).all()
    assert np.isnan(typical_depths(greys, [cameras[0]] * 6)).all()
    assert np.isnan(typical_depths([np.zeros_like(greys[0])] * 6, cameras)).all()
    assert typical_depths([], []).shape == (0,)
    assert np.isnan(typical_depths(greys[:1], cameras[:1])).all()
