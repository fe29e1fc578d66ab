"""Refinement of slightly wrong cameras by the matches of all views."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from textured_planes import camera

from slgaussian.cameras.relative import Relative
from slgaussian.predict.pose_refinement import anchor_cameras, refine_cameras

TRUE = [camera(x=x, y=y, turn=turn) for x, y, turn in
        [(0, 0, 0), (0.3, 0.05, -0.05), (0.6, -0.05, 0.02), (0.9, 0, -0.02)]]  # fmt: skip


def disturb(inputs, turn, move):
    c2w = inputs.c2w.copy()
    c2w[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ c2w[:3, :3]
    c2w[:3, 3] += move
    return replace(inputs, c2w=c2w)


def degrees(a, b):
    return np.degrees(Rotation.from_matrix(b.c2w[:3, :3] @ a.c2w[:3, :3].T).magnitude())


def observe(cameras, count=300, noise=0.0):
    """Keypoints of points before all cameras, and matches of each view with the next two."""
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.5, -0.6, 2.5), (1.4, 0.6, 5), (count, 3))
    keypoints = [c.project(points)[0] + rng.normal(0, noise, (count, 2)) for c in cameras]
    every = np.arange(count)
    pairs = [(i, j) for i in range(len(cameras)) for j in (i + 1, i + 2) if j < len(cameras)]
    return keypoints, dict.fromkeys(pairs, (every, every))


def off(cameras, true=TRUE):
    """Worst rotation in degrees between neighbours, and worst ratio of distances, less one."""
    pairs = [
        (Relative.between(a, b), Relative.between(c, d))
        for a, b, c, d in zip(cameras, cameras[1:], true, true[1:], strict=False)
    ]
    turned = max(np.degrees(Rotation.from_matrix(x.R @ y.R.T).magnitude()) for x, y in pairs)
    lengths = np.array([np.linalg.norm(x.t) / np.linalg.norm(y.t) for x, y in pairs])
    return turned, float(np.ptp(lengths / lengths.mean()))


def test_settled_cameras_are_nearer_to_the_truth_than_the_given_ones():
    rng = np.random.default_rng(1)
    inputs = [disturb(c, rng.normal(0, 0.005, 3), rng.normal(0, 0.01, 3)) for c in TRUE]
    keypoints, matches = observe(TRUE, noise=0.1)
    before, after = off(inputs), off(refine_cameras(inputs, keypoints, matches))
    assert before[0] > 0.3 and before[1] > 0.03
    # A tenth of a pixel at a focal length of 150 pixels: measured 0.13 and 0.009.
    assert after[0] < 0.2 and after[1] < 0.02


def test_cameras_that_fit_stay():
    keypoints, matches = observe(TRUE)
    for before, after in zip(TRUE, refine_cameras(TRUE, keypoints, matches), strict=True):
        assert np.allclose(before.c2w, after.c2w, atol=1e-6)


def test_a_frame_turned_as_a_whole_stays_where_it_was_given():
    """The world frame is not determined by matches, so the given one stays."""
    turn, middle = np.array([0.004, -0.003, 0.002]), np.mean([c.center for c in TRUE], 0)
    spin = Rotation.from_rotvec(turn).as_matrix()
    inputs = [disturb(c, turn, spin @ (c.center - middle) + middle - c.center) for c in TRUE]
    keypoints, matches = observe(TRUE)
    for before, after in zip(inputs, refine_cameras(inputs, keypoints, matches), strict=True):
        assert degrees(before, after) < 0.02
        assert np.linalg.norm(before.center - after.center) < 1e-3


def test_two_cameras_meet_half_way():
    turn, move = np.array([0.01, -0.02, 0.005]), np.array([0.02, 0.01, -0.03])
    refined = [TRUE[0], disturb(TRUE[1], turn, move)]
    met = anchor_cameras(TRUE[:2], refined, np.full((2, 2), 0.5))
    for before, after in zip(TRUE[:2], met, strict=True):
        assert degrees(before, after) == pytest.approx(np.degrees(np.linalg.norm(turn)) / 2)
    wanted = Relative.between(*refined)
    # Centres half way each are the wanted baseline but for the half turn between their frames.
    result = Relative.between(*met)
    assert np.allclose(result.R, wanted.R, atol=1e-12)
    assert np.linalg.norm(result.t - wanted.t) < 0.02 * np.linalg.norm(wanted.t)
