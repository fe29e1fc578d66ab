"""Grouping of clips into places by names, videos, shared photographs and equal cameras."""

import hashlib
import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.datasets.scene_grouping import POSE_COLUMNS, Membership, Places


def digest(name) -> str:
    return hashlib.sha256(str(name).encode()).hexdigest()


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(40, 200, 256).astype(np.uint8)


def view(clip, name, grey=None, place=None, video="", pose=None):
    """A row of spec ``views``; another name is another photograph."""
    grey = picture(int(digest(name)[:8], 16)) if grey is None else grey
    values = pose if pose is not None else np.random.default_rng(len(name)).uniform(size=12)
    return {
        "clip": clip,
        "place": place,
        "video": video,
        "digest": digest(name),
        "signature": grey.astype(np.uint8).tobytes().hex(),
        **dict(zip(POSE_COLUMNS, values, strict=True)),
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


def test_equal_cameras_join_clips_only_where_their_photographs_are_alike():
    rng = np.random.default_rng(5)
    poses, greys = rng.uniform(size=(3, 12)), [picture(seed) for seed in (1, 2, 3)]
    noisy = [grey + rng.integers(-28, 29, 256) for grey in greys]
    rows = [
        view(clip, f"{clip}{k}", grey, pose=pose)
        for clip, pictures, shift in (
            ("first", greys, 0),
            ("noisy", noisy, 0),
            ("elsewhere", noisy, 1),
            ("rig", [picture(seed) for seed in (7, 8, 9)], 0),
        )
        for k, (grey, pose) in enumerate(zip(pictures, poses + shift, strict=True))
    ]
    members = group(*[row for row in rows if row["clip"] != "elsewhere"])
    assert members["noisy"] == Membership("first", "cameras", "first")
    assert members["rig"] == Membership("rig")
    assert group(*[row for row in rows if row["clip"] in ("first", "elsewhere")])[
        "elsewhere"
    ] == Membership("elsewhere")


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
