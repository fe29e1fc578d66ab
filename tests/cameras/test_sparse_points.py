"""Points of matches with given cameras."""

import numpy as np
import pytest
from rendered_rooms import looking, pinhole

from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.sparse_points import triangulate_matches

CAMERAS = [pinhole(900, 1600, 1200, looking(np.array([x, -3.3, 0.9]))) for x in (-0.5, 0, 0.5)]


def project(points: np.ndarray) -> list[np.ndarray]:
    """Return the pixels [N, 2] of points in each view."""
    seen = [(points @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]) @ camera.K.T for camera in CAMERAS]
    return [xy[:, :2] / xy[:, 2:] for xy in seen]


def test_right_matches_form_tracks_that_wrong_ones_do_not_join():
    points = np.random.default_rng(0).uniform((-1, 0, 0), (1, 2, 2), (60, 3))
    points[50:] *= 1e4  # so far away that no angle tells how far
    match = np.arange(60), np.arange(60)
    to_wrong = np.concatenate([match[0], [0, 1]]), np.concatenate([match[1], [20, 21]])
    graph = MatchGraph(project(points), {(0, 1): match, (0, 2): to_wrong, (1, 2): match})
    tracks, found = triangulate_matches(CAMERAS, graph)
    assert tracks.count == 50 and (np.bincount(tracks.track) == 3).all()
    np.testing.assert_allclose(found, points[:50], atol=1e-9)
    np.testing.assert_array_equal(tracks.xy, np.stack(project(points[:50]), 1).reshape(-1, 2))


@pytest.mark.parametrize(("pixels", "count"), [(7.9, 1), (8.1, 0)])
def test_match_off_by_three_pixels_of_1200_is_no_point(pixels, count):
    """Two views halve the error, of photographs that are a third larger than their images."""
    points = np.array([[0.0, 1.0, 0.5]])
    keypoints = project(points)[:2]
    keypoints[1] = keypoints[1] + [0, pixels]  # across the epipolar line
    match = np.arange(1), np.arange(1)
    tracks, _ = triangulate_matches(CAMERAS[:2], MatchGraph(keypoints, {(0, 1): match}))
    assert tracks.count == count


def test_photographs_without_matches_have_no_points():
    tracks, points = triangulate_matches(CAMERAS, MatchGraph([np.zeros((0, 2))] * 3, {}))
    assert (tracks.count, len(tracks.view), points.shape) == (0, 0, (0, 3))
