"""Clips of one place are known by what was said, by their video and by shared photographs."""

import hashlib
import itertools

from hypothesis import given
from hypothesis import strategies as st

from slgaussian.datasets.scene_grouping import Places


def digest(name) -> str:
    return hashlib.sha256(str(name).encode()).hexdigest()


def test_what_is_said_goes_before_videos_and_these_before_clips():
    places = Places()
    places.add("a", [digest(1)], "office")
    places.add("b", [digest(2)])
    places.add("c", [digest(2), digest(3)])
    places.add("d")
    places.add("e")
    places.seen_in("b", "https://video/b")
    places.seen_in("e", "https://video/b")
    places.seen_in("d", "")
    video = "https://video/b"
    assert places.by_clip() == {"a": "office", "b": video, "c": video, "d": "d", "e": video}


@given(st.permutations(range(6)), st.lists(st.sets(st.integers(0, 8)), min_size=6, max_size=6))
def test_the_order_of_arrival_plays_no_part(order, photographs):
    def found(numbers):
        places = Places()
        for number in numbers:
            places.add(f"clip {number}", map(digest, photographs[number]))
        return places.by_clip()

    expected = found(range(6))
    assert found(order) == expected
    for a, b in itertools.combinations(range(6), 2):
        if photographs[a] & photographs[b]:
            assert expected[f"clip {a}"] == expected[f"clip {b}"]
