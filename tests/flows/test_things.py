"""The commands about things: objects, extract, remove, teach, and asking by picture."""

from dataclasses import replace

import numpy as np
import pytest
from command import run, said, two_walls
from PIL import Image
from plyfile import PlyData

from flows.cli import objects
from slgaussian.field import SemanticField

RED, BLUE = 1, 2


@pytest.fixture
def field(tmp_path):
    """Two walls whose bank knows where they are."""
    folder = two_walls(tmp_path / "field")
    loaded = SemanticField.load(folder)
    boxes = np.array([[[0, 0, 24, 32]] * 2, [[24, 0, 48, 32]] * 2], np.int32)
    replace(loaded, bank=replace(loaded.bank, boxes=boxes)).save(folder)
    return folder


def labels_of(ply) -> np.ndarray:
    """The object of each Gaussian of a file."""
    return np.asarray(PlyData.read(ply)["vertex"]["label"])


def test_what_is_in_a_field_is_listed(field, ask, monkeypatch, capsys):
    assert run(monkeypatch, "objects", "list", field) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:3]] == ["object", "1", "2"]
    assert "red" in lines[1] and "blue" in lines[2]
    assert lines[1].endswith("1.15 x 0.00 x 1.55  images/001.png, images/002.png")
    assert lines[-1] == "Sizes are in scene units, those of the given cameras."
    status, things = ask("objects", "list", field, "blue", "red wall")
    assert status == 0 and [first["id"] for first in things] == [RED, BLUE]
    assert [first["words"][0] for first in things] == ["red wall", "blue"]
    assert run(monkeypatch, "objects", "list", field, "yellow") == 0
    assert capsys.readouterr().out.count("(yellow") == 2
    monkeypatch.setattr(objects, "LARGEST", 1)
    for words, count in (([], 1), (["--all"], 2)):
        assert run(monkeypatch, "objects", "list", field, "yellow", *words) == 0
        out = capsys.readouterr().out
        assert out.count("(yellow") == count
        assert ("1 smaller ones are listed with --all" in out) == (count == 1)


def test_a_thing_is_taken_out(field, tmp_path, monkeypatch, capsys):
    labels = SemanticField.load(field).labels()
    for text in ("red wall", RED):
        assert run(monkeypatch, "objects", "extract", field, text, "-o", tmp_path / "red.ply") == 0
        local = labels_of(tmp_path / "red.ply")
        assert len(local) == (labels == RED).sum() and (local == RED).all()
    assert run(monkeypatch, "objects", "extract", field, "red", "-o", tmp_path / "red") == 0
    assert set(SemanticField.load(tmp_path / "red").labels().tolist()) == {RED}
    capsys.readouterr()
    assert run(monkeypatch, "objects", "extract", field, "yellow", "-o", tmp_path / "x.ply") == 3
    assert "nothing found for 'yellow'" in capsys.readouterr().out
    assert not (tmp_path / "x.ply").exists()


def test_what_is_removed_is_gone_and_what_is_left_open_is_striped(
    field, tmp_path, ask, monkeypatch, capsys
):
    out = tmp_path / "without"
    assert run(monkeypatch, "objects", "remove", field, "red wall", "-o", out) == 0
    assert capsys.readouterr().out.startswith("'red wall': objects 1 (")
    left = SemanticField.load(out)
    assert left.removed == {RED} and RED not in left.labels()
    assert SemanticField.load(field).removed == frozenset()
    status, (answer,) = ask("query", out, "red")
    assert status == 3 and not answer["found"]
    assert [first["id"] for first in ask("objects", "list", out)[1]] == [BLUE]
    assert run(monkeypatch, "render", out, "-o", tmp_path / "a.png") == 0
    opened = np.asarray(Image.open(tmp_path / "a.png")).astype(int)[4:-4, 4:18]
    assert (np.ptp(opened, axis=2) == 0).all() and np.ptp(opened) > 40  # grey stripes
    assert run(monkeypatch, "export", out, "-o", tmp_path / "a.ply") == 0
    assert RED not in labels_of(tmp_path / "a.ply")


def test_a_word_is_taught_by_a_click_asked_and_forgotten(field, ask, monkeypatch, capsys):
    assert run(monkeypatch, "query", field, "zorp") == 3
    assert capsys.readouterr().out.startswith("cannot tell: no word 'zorp' is known here")
    assert run(monkeypatch, "objects", "teach", field, "Zorp", "--at", 8, 16) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["'Zorp' is object 1", "examples  1"]
    status, (answer, valid) = ask("query", field, "zorp", "blue", "--view", 1)
    assert status == 3 and [first["id"] for first in answer["objects"]] == [RED]
    assert (answer["kind"], answer["examples"]) == ("taught", 1)
    assert valid["kind"] == "known" and valid["examples"] == 0
    assert run(monkeypatch, "query", field, "zorp") == 0
    assert "a taught word: 1 example" in capsys.readouterr().out
    assert run(monkeypatch, "objects", "teach", field, "blue", "--at", 8, 16, "--view", 1) == 0
    assert run(monkeypatch, "query", field, "blue") == 0
    assert "not as the encoder knows it: blue" in capsys.readouterr().out
    assert run(monkeypatch, "objects", "teach", field, "blue", "--forget") == 0
    assert ask("query", field, "blue")[1][0]["kind"] == "known"


def test_a_name_is_asked_and_taken_like_a_word(field, tmp_path, ask, monkeypatch, capsys):
    SemanticField.load(field).named(BLUE, "Anna's wall").save_edits(field)
    status, (answer,) = ask("query", field, "anna's  WALL")
    assert status == 0 and [first["id"] for first in answer["objects"]] == [BLUE]
    assert (answer["kind"], answer["verdict"], answer["confidence"]) == ("named", "found", None)
    assert run(monkeypatch, "query", field, "Anna's wall") == 0
    assert "a name that you gave" in capsys.readouterr().out
    assert (
        run(monkeypatch, "objects", "extract", field, "anna's wall", "-o", tmp_path / "wall.ply")
        == 0
    )
    assert set(labels_of(tmp_path / "wall.ply")) == {BLUE}


def test_a_field_is_asked_by_picture(field, tmp_path, ask, monkeypatch, capsys):
    Image.new("RGB", (20, 16), (10, 25, 205)).save(tmp_path / "crop.png")
    status, (answer, red) = ask("query", field, "--like", tmp_path / "crop.png", "red")
    red, answer = sorted([answer, red], key=lambda first: first["kind"])
    assert answer["kind"] == "picture" and red["kind"] == "known"
    assert [first["id"] for first in answer["objects"]] == [BLUE] and status == 3
    # The colour of the picture fits one object exactly; the word leaves some doubt.
    assert (answer["verdict"], red["verdict"]) == ("found", "not sure")
    (tmp_path / "broken.png").write_bytes(b"no picture")
    assert run(monkeypatch, "query", field, "--like", tmp_path / "broken.png") == 2
    assert "broken.png" in said(capsys)
