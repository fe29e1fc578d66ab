"""Duplicate photographs and photographs of other places on the command line."""

import pytest
from command import write_photographs

from slgaussian.field import SemanticField
from tests.predict import twists

SIZE = 96, 128
NAMES = ("a.png", "b.png", "c.png")


@pytest.fixture
def photos(tmp_path, monkeypatch):
    """Write three photographs of a room, a copy and one of another room to the current folder."""
    inputs = twists.arc(0, 3, SIZE)
    views = dict(zip(NAMES, inputs.context, strict=True))
    views |= {"copy.png": inputs.context[1], "elsewhere.png": twists.stranger(0, inputs, 0)}
    write_photographs(tmp_path, views)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_copy_and_a_stranger_are_left_out_by_name(photos, slg):
    words = (*NAMES, "copy.png", "elsewhere.png", "--cameras", "transforms.json")
    status, _, errors = slg("field", *words, "-v", "-o", "odd")
    assert status == 0
    assert [line for line in errors.splitlines() if "left out" in line] == [
        "warning: copy.png is left out: it is the same picture as b.png, from the same place",
        "warning: elsewhere.png is left out: fewer than 12 matches with any other tell its depth",
    ]
    assert list(SemanticField.load("odd").cameras) == list(NAMES)


def test_a_field_of_other_photographs_is_replaced_only_by_force(photos, slg, refusal):
    words = ("--cameras", "transforms.json", "-o", "field", "--size", "48x64")
    assert slg("field", "a.png", "b.png", *words)[0] == 0
    before = (photos / "field/gaussians.npz").read_bytes()
    assert slg("field", "a.png", "b.png", *words)[0] == 0
    for other in (("b.png", "c.png"), ("a.png", "b.png", "c.png")):
        assert "field: holds a field of other photographs" in refusal("field", *other, *words)
    assert (photos / "field/gaussians.npz").read_bytes() == before
    assert slg("field", "b.png", "c.png", *words, "--force")[0] == 0
    assert (photos / "field/gaussians.npz").read_bytes() != before
