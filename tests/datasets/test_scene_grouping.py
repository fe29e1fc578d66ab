"""Grouping of clips into places by names, videos and shared photographs."""

import hashlib
import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.datasets.scene_grouping import Membership, Places


def digest(name) -> str:
    return hashlib.sha256(str(name).encode()).hexdigest()


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(40, 200, 256).astype(np.uint8)


def view(clip, name, grey=None, place=None, video=""):
    """A row of spec ``views``; another name is another photograph."""
    grey = picture(int(digest(name)[:8], 16)) if grey is None else grey
    return {
        "clip": clip,
        "place": place,
        "video": video,
        "digest": digest(name),
        "signature": grey.astype(np.uint8).tobytes().hex(),
    }


def group(*rows) -> dict[str, Membership]:
    places = Places()
    places.add_views(rows)
    return places.by_clip()


def test_declared_name_precedes_video_and_video_precedes_clip():
    video = "https://video/b"
    members = group(
        view("a", "1", place="office"),
        view("b", "2", video=video),
        view("c", "2"),
        view("c", "3"),
        view("d", "4"),
        view("e", "5", video=video),
    )
    named = {clip: member.place for clip, member in members.items()}
    assert named == {"a": "office", "b": video, "c": video, "d": "d", "e": video}
    told = {clip: (member.why, member.other) for clip, member in members.items()}
    assert told["c"] == ("bytes", "b") and told["e"] == told["e"] == ("video", "b")
    assert told["a"] == told["d"] == ("alone", None)


def test_near_copies_join_clips_by_their_signatures():
    original, other = picture(0), picture(1)
    tones = {
        "brighter": original + 9,
        "compressed": original + np.random.default_rng(2).integers(-4, 5, 256),
        "contrast": 1.2 * original,
    }
    members = group(
        view("original", "0", other),
        view("original", "00", original),
        *(view(clip, clip, grey) for clip, grey in tones.items()),
        view("another", "8", other[::-1]),
        *(view(clip, "the same bytes", np.zeros(256)) for clip in ("black", "fade")),
    )
    assert {members[clip].place for clip in ("original", *tones)} == {"brighter"}
    assert members["contrast"].why == "near copy"
    assert [members[c].place for c in ("another", "black", "fade")] == ["another", "black", "fade"]


@given(st.permutations(range(6)), st.lists(st.sets(st.integers(0, 8)), min_size=6, max_size=6))
def test_grouping_does_not_depend_on_the_order_of_clips(order, photographs):
    def places(numbers):
        names = [(f"clip {n}", str(name)) for n in numbers for name in photographs[n] or {f"x{n}"}]
        return {
            clip: member.place for clip, member in group(*itertools.starmap(view, names)).items()
        }

    expected = places(range(6))
    assert places(order) == expected
    for a, b in itertools.combinations(range(6), 2):
        if photographs[a] & photographs[b]:
            assert expected[f"clip {a}"] == expected[f"clip {b}"]
