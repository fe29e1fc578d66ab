"""Questions from any viewpoint, as users ask them."""

import json

import cv2
import numpy as np
import pytest
from command import run, said, transforms, two_walls
from PIL import Image

import slgaussian as slg
from slgaussian.masks.precomputed import read_ids

FIRST, SECOND = "images/001.png", "images/002.png"


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    return two_walls(tmp_path_factory.mktemp("questions") / "field")


def test_a_text_that_is_refused_does_not_take_the_others_along(field, ask, monkeypatch, capsys):
    status, answers = ask("query", field, "red", "qwxyz", "not blue", "blue")
    assert status == 1
    assert [(a["text"], a["verdict"]) for a in answers] == [
        ("red", "not sure"), ("qwxyz", "cannot tell"), ("not blue", None), ("blue", "not sure"),
    ]  # fmt: skip
    assert [a["refused"] is None for a in answers] == [True, True, False, True]
    assert "qwxyz" in answers[1]["summary"] and "'not'" in answers[2]["refused"]
    assert run(monkeypatch, "query", field, "red", "not blue") == 1
    assert "'not blue' is refused: " in capsys.readouterr().out
    assert run(monkeypatch, "query", field, "not red", "not blue") == 2
    error = said(capsys)
    assert "not red" in error and "not blue" in error


def test_a_refused_text_is_named_by_objects_and_segment(field, ask, monkeypatch, capsys):
    status, rows = ask("objects", "list", field, "red", "zeppelin", "blue")
    assert status == 1
    assert [row["words"] for row in rows if "id" in row] == [["red", "blue"], ["blue", "red"]]
    assert "zeppelin" in rows[-1]["refused"]
    status, rows = ask("segment", field, "not green", "red", "blue")
    assert status == 1
    assert [(row["text"], row.get("label")) for row in rows] == [
        ("red", 2), ("blue", 3), (None, 0), ("not green", None),
    ]  # fmt: skip
    for command in (["objects", "list"], ["segment"]):
        assert run(monkeypatch, *command, field, "red", "not green") == 1
        assert "'not green' is refused: " in capsys.readouterr().out


def test_where_nothing_is_found_there_is_no_point(field, tmp_path, ask, monkeypatch, capsys):
    status, (answer,) = ask("query", field, "yellow")
    assert status == 3
    assert (answer["found"], answer["point"], answer["objects"]) == (False, None, [])
    assert 0 < answer["score"] < 0.5
    assert run(monkeypatch, "query", field, "yellow", "-o", tmp_path / "a.png") == 3
    assert "not here: the best object scores 0." in capsys.readouterr().out
    # Neither is one drawn: the last panel is the rendering.
    picture = np.asarray(Image.open(tmp_path / "a.png"))[12:44]
    np.testing.assert_array_equal(picture[:, 12:60], picture[:, 132:180])
    assert run(monkeypatch, "query", field, "red", "-o", tmp_path / "b.png") == 3
    picture = np.asarray(Image.open(tmp_path / "b.png"))[12:44]
    assert (picture[:, 12:60] != picture[:, 132:180]).any()
    # The best guess stays where it is asked for.
    view = slg.SemanticField.load(field)
    assert view.render(view.cameras[FIRST]).query("yellow").point is not None


def test_which_words_count_is_said(field, ask):
    _, (answer,) = ask("query", field, "red plant wall in the quixotic sofa")
    assert (answer["read_as"], answer["unknown"]) == ("red wall", [])
    assert list(answer["unused"]) == ["plant", "in", "quixotic", "sofa"]


def test_a_query_from_between_two_views(field, ask):
    names = ["--between", "001", "1"]
    status, (middle,) = ask("query", field, "red", *names, "0.5")
    assert status == 3
    assert middle["view"] == f"between {FIRST} and {SECOND} at 0.5"
    _, (first,) = ask("query", field, "red")
    _, (second,) = ask("query", field, "red", "--view", "1")
    # The second camera stands 0.2 to the right of a wall 2 away: the edge moves by 4 pixels.
    assert second["pixels"] < middle["pixels"] < first["pixels"]
    assert middle["pixels"] == pytest.approx((first["pixels"] + second["pixels"]) / 2, abs=32)
    for share, end in (("0", first), ("1", second)):
        _, (inside,) = ask("query", field, "red", *names, share)
        assert {**inside, "view": end["view"]} == end


def test_a_camera_file_may_hold_one_camera_or_many(field, tmp_path, ask, monkeypatch, capsys):
    file = transforms(tmp_path, 0.1)
    _, (listed,) = ask("query", field, "red", "--camera", file)
    assert listed["view"] == "new/007.png"
    frames = json.loads(file.read_text())
    item = {**frames, **frames.pop("frames")[0]}
    del item["frames"], item["file_path"]
    (tmp_path / "camera.json").write_text(json.dumps(item))
    _, (alone,) = ask("query", field, "red", "--camera", tmp_path / "camera.json")
    assert alone == {**listed, "view": "camera.json"}
    # It is OpenGL's: a camera that looks the other way sees nothing of the walls.
    item["transform_matrix"] = np.eye(4).tolist()
    (tmp_path / "camera.json").write_text(json.dumps(item))
    status, (away,) = ask("query", field, "red", "--camera", tmp_path / "camera.json")
    assert (status, away["found"], away["score"]) == (3, False, 0)
    assert away["summary"] == "not here: this view shows no object"
    del item["w"]
    (tmp_path / "camera.json").write_text(json.dumps(item))
    assert run(monkeypatch, "query", field, "red", "--camera", tmp_path / "camera.json") == 2
    assert "frame 'camera.json': has neither w and h" in said(capsys)


def test_a_turn_is_a_film_whose_frames_decode(field, tmp_path, monkeypatch):
    film = tmp_path / "turn.mp4"
    assert run(monkeypatch, "render", field, "--orbit", "5", "-o", film) == 0
    assert [file.name for file in tmp_path.iterdir()] == [film.name]
    reader, frames = cv2.VideoCapture(str(film)), []
    while (read := reader.read())[0]:
        frames.append(read[1][..., ::-1])
    assert len(frames) == 5
    local = slg.SemanticField.load(field)
    points = local.gaussians.means.numpy()
    turn = slg.cameras.orbit(list(local.cameras.values()), points, 5)
    for frame, camera in zip(frames, turn, strict=True):
        observed = local.render(camera).rgb.astype(int)
        assert np.abs(frame.astype(int) - observed).mean() < 12


def test_a_segmentation_is_a_picture_an_id_map_and_a_table(
    field, tmp_path, ask, monkeypatch, capsys
):
    out = tmp_path / "labels.png"
    status, rows = ask("segment", field, "blue", "green", "red", "-o", out)
    assert status == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["labels.ids.png", "labels.png"]
    ids = read_ids(tmp_path / "labels.ids.png")
    local = slg.SemanticField.load(field)
    view = local.render(local.cameras[FIRST])
    np.testing.assert_array_equal(ids, view.segment(["blue", "green", "red"]))
    assert ids[16, 4] == 3 and ids[16, 44] == 1
    for row in rows:
        assert row["share"] == pytest.approx((ids == row["label"]).mean())
    assert [row["objects"] for row in rows] == [[2], [], [1], []]
    assert rows[1]["relevancy"] is None
    assert rows[0]["relevancy"] == pytest.approx(view.query("blue").scores[1], abs=1e-6)
    assert run(monkeypatch, "segment", field, "blue", "green", "red", "-o", out) == 0
    printed = capsys.readouterr().out
    assert "    1  blue" in printed and str(tmp_path / "labels.ids.png") in printed
    assert Image.open(out).height > 12 + 32 + 34  # a legend below
