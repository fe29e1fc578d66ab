"""The graph of matches against plain matching, and after a round trip through the store."""

import numpy as np

from slgaussian import datasets
from slgaussian.cameras.match_graph import MatchGraph
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
