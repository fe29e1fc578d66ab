"""The graph of matches: as plain matching finds it, and the same after it was stored."""

import numpy as np

from slgaussian import datasets
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.storage.store import ArtifactStore
from tests.matching import sift_matches


def test_the_graph_holds_the_matches_of_pairs_and_is_stored_as_it_is(tmp_path):
    scene = datasets.load("procedural", seed=0, objects=4, views=4, height=90, width=120)
    views = scene.sample(list(scene.cameras)).context
    graph = MatchGraph.of(views)
    assert {(0, 1), (1, 2), (2, 3)} <= set(graph.matches)
    for (i, j), (first, second) in graph.matches.items():
        expected = sift_matches(views[i].grey, views[j].grey)
        np.testing.assert_array_equal(graph.points(i, j), expected)
        assert len(first) == len(second)
    store = ArtifactStore(tmp_path)
    again = MatchGraph.from_arrays(store.get(store.put("matches", graph.to_arrays())))
    assert list(again.matches) == list(graph.matches)
    for pair in graph.matches:
        np.testing.assert_array_equal(again.points(*pair), graph.points(*pair))
    empty = MatchGraph.of(views[:1])
    assert MatchGraph.from_arrays(empty.to_arrays()).matches == {}
