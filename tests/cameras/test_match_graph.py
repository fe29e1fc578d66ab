"""The graph of matches: against plain matching, through the store, and from found cameras."""

from dataclasses import replace

import numpy as np
import pytest
from hard_photographs import room_pair

from slgaussian import datasets
from slgaussian.build import select_usable
from slgaussian.cameras import match_graph, matches
from slgaussian.cameras.check import check_pairs
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.match_graph import MatchGraph, match_views
from slgaussian.scene import Scene, View
from slgaussian.storage.store import ArtifactStore
from tests.matching import sift_matches


def test_graph_equals_plain_matching_and_survives_a_round_trip(tmp_path):
    scene = datasets.load("procedural", seed=0, objects=4, views=4, height=90, width=120)
    views = scene.sample(list(scene.cameras)).context
    graph = MatchGraph.of(views)
    assert {(0, 1), (1, 2), (2, 3)} <= set(graph.matches)
    for (i, j), (first, second) in graph.matches.items():
        expected = sift_matches(views[i].grey, views[j].grey)
        np.testing.assert_array_equal(graph.points(i, j), expected)
        assert len(first) == len(second)
    store = ArtifactStore(tmp_path)
    restored = MatchGraph.from_arrays(store.get(store.put("matches", graph.to_arrays())))
    assert list(restored.matches) == list(graph.matches)
    for pair in graph.matches:
        np.testing.assert_array_equal(restored.points(*pair), graph.points(*pair))
    empty = MatchGraph.of(views[:1])
    assert MatchGraph.from_arrays(empty.to_arrays()).matches == {}


@pytest.fixture(scope="module")
def found_scene() -> Scene:
    """Return a scene of two photographs of 480x360 pixels whose cameras were found."""
    result = find_cameras(room_pair())
    images = {photograph.name: photograph.image for photograph in room_pair()}
    cameras = result.cameras
    return Scene("room", cameras, lambda n: View(n, cameras[n], images[n]), matches=result.matches)


@pytest.mark.parametrize("size", ["original", (180, 240), (180, 200), (200, 240)])
def test_matches_of_found_cameras_fit_resized_and_cropped_views(found_scene, size):
    sample = found_scene.sample(list(found_scene.cameras), size=size)
    (check,) = check_pairs(sample)
    anew = check_pairs(replace(sample, matches=None))[0]
    assert check.matches > 0.8 * anew.matches and check.judged and not check.refuted
    assert check.precise > 0.95 and check.coarse > 0.9
    height, width = sample.context[0].image.shape[:2]
    for points in match_views(sample).points(0, 1):
        assert (points > 0).all() and (points < (width, height)).all()


def test_matches_of_found_cameras_are_made_once(found_scene, monkeypatch):
    for module in (match_graph, matches):
        monkeypatch.setattr(module, "sift", lambda grey: pytest.fail("features are found again"))
    sample, left_out = select_usable(
        found_scene.sample(list(found_scene.cameras)[::-1], size=(180, 240))
    )
    assert not left_out and sample.context[0].name == "b.jpg"
    assert not check_pairs(sample)[0].refuted


def test_graph_of_some_views_keeps_their_matches_in_the_new_order():
    keypoints = [np.full((2, 2), float(view)) for view in range(3)]
    indices = np.array([0, 1]), np.array([1, 0])
    graph = MatchGraph(keypoints, {(0, 1): indices, (1, 2): indices})
    swapped = graph.select([2, 1])
    assert list(swapped.matches) == [(0, 1)] and swapped.keypoints[0][0, 0] == 2
    np.testing.assert_array_equal(swapped.matches[0, 1], indices[::-1])
    assert graph.connects_all and swapped.connects_all
    assert not graph.select([0, 2]).connects_all
