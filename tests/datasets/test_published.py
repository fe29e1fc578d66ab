"""A published scene is known by what is in it, and by nothing that a folder is called."""

from dataclasses import replace

import pytest

from slgaussian.datasets.published import (
    ANOTHER,
    RECOGNISED,
    SETS,
    UNVERIFIED,
    LabelledFrames,
    Standing,
    standing,
)

KNOWN = [(format, name) for format, scenes in SETS.items() for name in scenes]


def found_of(format: str, name: str) -> LabelledFrames:
    """All of a published scene, in a folder of its name."""
    scene = SETS[format][name]
    asked = dict.fromkeys(scene.frames, scene.texts or ("something",))
    sizes = {} if scene.size is None else dict.fromkeys(scene.frames, scene.size)
    return LabelledFrames(format, name, asked, scene.frames, sizes)


@pytest.mark.parametrize(("format", "name"), KNOWN)
def test_a_published_scene_is_itself_in_any_folder(format, name):
    found = found_of(format, name)
    sure = RECOGNISED if SETS[format][name].texts else UNVERIFIED
    assert standing(found) == Standing(sure, format, name)
    elsewhere = replace(found, format="colmap", name="my office")
    assert standing(elsewhere) == (Standing(sure, format, name) if sure == RECOGNISED else None)


def test_one_frame_with_a_few_of_its_labels_is_enough():
    """A pair of views is asked in one frame, which shows some of what is labelled."""
    teatime = found_of("lerf_ovs", "teatime")
    asked = {"frame_00043": ("sheep", "Hooves", "apple", "a new text")}
    one = replace(teatime, texts=asked)
    assert standing(one) == Standing(RECOGNISED, "lerf_ovs", "teatime")
    strange = {"frame_00043": ("sheep", "apple", "office chair", "monitor")}
    known = standing(replace(teatime, texts=strange))
    assert known is not None and known.standing == ANOTHER
    assert known.why.startswith("found labels of office chair, monitor, expected sheep, ")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"texts": {}}, "found labelled frames none, expected frame_00002, "),
        ({"texts": {"00015": ("sheep",)}}, "found labelled frames 00015, expected frame_00002, "),
        ({"texts": {"frame_00002": ()}}, "found labels of nothing, expected sheep, "),
        ({"sizes": {}}, "found frame_00002 of no size pixels, expected 988x730"),
        (
            {"sizes": dict.fromkeys(SETS["lerf_ovs"]["teatime"].frames, (540, 360))},
            "found frame_00002 of 540x360 pixels, expected 988x730",
        ),
    ],
)
def test_what_differs_is_said_of_a_scene_of_that_name(change, why):
    another = standing(replace(found_of("lerf_ovs", "teatime"), **change))
    assert another is not None
    assert (another.standing, another.scene) == (ANOTHER, "teatime")
    assert another.why.startswith(why)
    assert standing(replace(found_of("lerf_ovs", "teatime"), name="mine", **change)) is None


def test_where_texts_are_not_published_all_frames_must_be_there():
    desk = found_of("ovs3d", "covered_desk")
    fewer = standing(replace(desk, frames=("00", "01")))
    assert fewer is not None and fewer.standing == ANOTHER
    assert fewer.why == "found labelled frames 00, 01, expected 00, 01, 11, 26 ..."
