"""Grouping of clips into places by declared names, videos and shared photographs."""

import hashlib
import itertools

from hypothesis import given
from hypothesis import strategies as st

from slgaussian.datasets.scene_grouping import Places


def digest(name) -> str:
    return hashlib.sha256(str(name).encode()).hexdigest()


def test_declared_name_precedes_video_and_video_precedes_clip():
    places, video = Places(), "https://video/b"
    places.add("a", [digest(1)], "office")
    places.add("b", [digest(2)])
    places.add("c", [digest(2), digest(3)])
    places.add("d")
    places.add("e")
    places.seen_in("b", video)
    places.seen_in("e", video)
    places.seen_in("d", "")
    assert places.by_clip() == {"a": "office", "b": video, "c": video, "d": "d", "e": video}


@given(st.permutations(range(6)), st.lists(st.sets(st.integers(0, 8)), min_size=6, max_size=6))
def test_grouping_does_not_depend_on_the_order_of_clips(order, photographs):
    def group(numbers):
        places = Places()
        for number in numbers:
            places.add(f"clip {number}", map(digest, photographs[number]))
        return places.by_clip()

    expected = group(range(6))
    assert group(order) == expected
    for a, b in itertools.combinations(range(6), 2):
        if photographs[a] & photographs[b]:
            assert expected[f"clip {a}"] == expected[f"clip {b}"]
