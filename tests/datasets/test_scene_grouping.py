"""Grouping of clips into places by declared names, videos and shared photographs."""

import hashlib
import itertools

import numpy as np
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


def test_near_copies_join_clips_by_their_signatures():
    rng = np.random.default_rng(0)
    picture, other = rng.integers(40, 200, (2, 256)).astype(np.uint8)
    tones = {
        "brighter": picture + 9,
        "compressed": picture + rng.integers(-4, 5, 256).astype(np.uint8),
        "contrast": (1.2 * picture).astype(np.uint8),
    }
    places = Places()
    places.add("original", [digest(0)], signatures=[other.tobytes().hex(), picture.tobytes().hex()])
    for number, (clip, grey) in enumerate(tones.items(), 1):
        places.add(clip, [digest(number)], signatures=[grey.astype(np.uint8).tobytes().hex()])
    places.add("another", [digest(8)], signatures=[other[::-1].tobytes().hex()])
    for clip in ("black", "grey"):
        places.add(clip, [digest(clip)], signatures=[bytes(256).hex()])
    by_clip = places.by_clip()
    assert {by_clip[clip] for clip in ("original", *tones)} == {"brighter"}
    assert [by_clip[clip] for clip in ("another", "black", "grey")] == ["another", "black", "grey"]


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
