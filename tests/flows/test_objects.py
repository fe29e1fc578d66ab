"""Commands on objects: listed, extracted, removed, taught, named, and queried by a picture."""

import shutil

import numpy as np
import pytest
from PIL import Image

from flows.cli import objects
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply
from slgaussian.formats.splats import load_gaussians

RED, BLUE = 1, 2


@pytest.fixture
def field(walls, tmp_path):
    """The two walls, to be changed."""
    return shutil.copytree(walls, tmp_path / "field")


def list_ids(answer) -> list[int]:
    return [item["id"] for item in answer["objects"]]


def test_objects_list_prints_words_sizes_and_views(walls, ask, slg, monkeypatch):
    status, out, _ = slg("objects", "list", walls)
    lines = out.splitlines()
    assert status == 0
    assert [line.split()[0] for line in lines[:3]] == ["object", "1", "2"]
    assert "red" in lines[1] and "blue" in lines[2]
    assert lines[1].endswith("1.15 x 0.00 x 1.55  images/001.png, images/002.png")
    assert lines[-1] == "Sizes are in scene units, those of the given cameras."
    status, rows = ask("objects", "list", walls, "blue", "red wall")
    assert status == 0 and [row["id"] for row in rows] == [RED, BLUE]
    assert [row["words"][0] for row in rows] == ["red wall", "blue"]
    monkeypatch.setattr(objects, "MAX_LISTED", 1)
    for words, count in (([], 1), (["--all"], 2)):
        status, out, _ = slg("objects", "list", walls, "yellow", *words)
        assert status == 0 and out.count("(yellow") == count
        assert ("1 smaller ones are listed with --all" in out) == (count == 1)


def test_objects_extract_writes_the_object_alone(walls, tmp_path, slg):
    whole = SemanticField.load(walls)
    red = whole.gaussians.to_arrays()["means"][whole.labels() == RED]
    for text in ("red wall", RED):
        assert slg("objects", "extract", walls, text, "-o", tmp_path / "red.ply")[0] == 0
        np.testing.assert_array_equal(load_ply(tmp_path / "red.ply")[0].means, red)
    assert slg("objects", "extract", walls, "red", "-o", tmp_path / "red.spz")[0] == 0
    assert len(load_gaussians(tmp_path / "red.spz")[0]) == len(red)
    assert slg("objects", "extract", walls, "red", "-o", tmp_path / "red")[0] == 0
    assert set(SemanticField.load(tmp_path / "red").labels().tolist()) == {RED}
    status, out, _ = slg("objects", "extract", walls, "yellow", "-o", tmp_path / "x.ply")
    assert status == 3 and "nothing found for 'yellow'" in out
    assert not (tmp_path / "x.ply").exists()


def test_objects_remove_leaves_stripes_behind_the_object(walls, tmp_path, ask, slg, refusal):
    out = tmp_path / "without"
    status, printed, _ = slg("objects", "remove", walls, "red wall", RED, "-o", out)
    first, second, _ = printed.splitlines()
    assert status == 0 and first.startswith("'red wall': objects 1 (")
    assert second == "'1': objects 1 (1.000), 0 Gaussians"
    assert "'1': is no object of" in refusal("objects", "extract", out, RED, "-o", tmp_path / "1")
    left = SemanticField.load(out)
    assert left.edits.removed == {RED} and RED not in left.labels()
    assert SemanticField.load(walls).edits.removed == frozenset()
    status, (answer,) = ask("query", out, "red")
    assert status == 3 and not answer["found"]
    status, rows = ask("objects", "list", out, "-o", tmp_path / "list.png")
    drawn = np.asarray(Image.open(tmp_path / "list.png")).astype(int)
    assert [row["id"] for row in rows] == [BLUE] and (drawn[..., 2] - drawn[..., 0] > 100).any()
    assert slg("render", out, "-o", tmp_path / "a.png")[0] == 0
    opened = np.asarray(Image.open(tmp_path / "a.png")).astype(int)[4:-4, 4:18]
    assert (np.ptp(opened, axis=2) == 0).all() and np.ptp(opened) > 40  # grey stripes
    assert slg("export", out, "-o", tmp_path / "a.ply", "--full")[0] == 0
    assert RED not in load_ply(tmp_path / "a.ply")[1]["label"]


def test_objects_teach_adds_and_forgets_a_word(field, ask, slg):
    status, out, _ = slg("query", field, "zorp")
    assert status == 3 and out.startswith("cannot tell: no word 'zorp' is known here")
    status, out, _ = slg("objects", "teach", field, "Zorp", "--at", 8, 16)
    assert status == 0 and out.splitlines()[:2] == ["'Zorp' is object 1", "examples  1"]
    status, (taught, other) = ask("query", field, "zorp", "blue", "--view", 1)
    assert status == 3 and list_ids(taught) == [RED]
    assert (taught["kind"], taught["examples"]) == ("taught", 1)
    assert (other["kind"], other["examples"]) == ("known", 0)
    status, out, _ = slg("query", field, "zorp")
    assert status == 0 and "a taught word: 1 example" in out
    assert slg("objects", "teach", field, "blue", "--at", 8, 16, "--view", 1)[0] == 0
    status, out, _ = slg("query", field, "blue")
    assert status == 0 and "not as the encoder knows it: blue" in out
    assert slg("objects", "teach", field, "blue", "--forget")[0] == 0
    assert ask("query", field, "blue")[1][0]["kind"] == "known"


def test_objects_name_is_used_by_query_and_extract(field, tmp_path, ask, slg):
    status, out, _ = slg("objects", "name", field, BLUE, "Anna's wall")
    assert (status, out) == (0, 'object 2 is "Anna\'s wall"\n')
    status, (answer,) = ask("query", field, "anna's  WALL")
    assert status == 0 and list_ids(answer) == [BLUE]
    assert (answer["kind"], answer["verdict"], answer["confidence"]) == ("named", "found", None)
    assert "a name that you gave" in slg("query", field, "Anna's wall")[1]
    assert slg("objects", "extract", field, "anna's wall", "-o", tmp_path / "wall")[0] == 0
    assert set(SemanticField.load(tmp_path / "wall").labels().tolist()) == {BLUE}
    assert slg("objects", "name", field, BLUE)[1] == "object 2 has no name\n"
    assert ask("query", field, "Anna's wall")[1][0]["kind"] != "named"


def test_query_like_finds_the_object_of_a_picture(walls, tmp_path, ask, refusal):
    Image.new("RGB", (20, 16), (10, 25, 205)).save(tmp_path / "crop.png")
    status, (red, answer) = ask("query", walls, "--like", tmp_path / "crop.png", "red")
    assert (answer["kind"], red["kind"]) == ("picture", "known")
    assert list_ids(answer) == [BLUE] and status == 3
    # The colour of the picture fits one object exactly; the word leaves some doubt.
    assert (answer["verdict"], red["verdict"]) == ("found", "not sure")
    (tmp_path / "broken.png").write_bytes(b"no picture")
    assert "broken.png" in refusal("query", walls, "--like", tmp_path / "broken.png")
