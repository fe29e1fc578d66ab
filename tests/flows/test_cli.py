"""Queries, renderings and exports of a field by commands."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from command import transforms
from PIL import Image

from slgaussian.cameras import orbit
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply
from slgaussian.formats.splats import READERS, save_gaussians
from slgaussian.masks.precomputed import read_ids

FIRST, SECOND = "images/001.png", "images/002.png"


def pixels(file) -> np.ndarray:
    return np.asarray(Image.open(file)).astype(int)


def test_texts_and_views_are_answered_in_turn(walls, tmp_path, ask, slg):
    words = ["query", walls, "red", "blue", "--view", "0", "--view", "002"]
    status, answers = ask(*words, "-o", tmp_path / "a.png")
    assert status == 3
    calls = [(a["text"], a["view"], a["objects"][0]["id"]) for a in answers]
    assert calls == [("red", FIRST, 1), ("blue", FIRST, 2), ("red", SECOND, 1), ("blue", SECOND, 2)]
    assert answers[0]["point"][0] < 24
    assert answers[0]["pixels"] == pytest.approx(32 * 24, abs=64)
    assert slg("query", walls, "red", "-o", tmp_path / "b.png")[0] == 3
    assert Image.open(tmp_path / "a.png").height == 4 * Image.open(tmp_path / "b.png").height
    status, out, _ = slg(*words)
    assert status == 3 and "'blue' in images/002.png" in out and "objects  2 (" in out


def test_a_query_follows_its_rules(walls, ask):
    def objects(*words):
        status, (answer,) = ask("query", walls, "red", *words)
        assert status == (0 if answer["found"] else 3)
        return [item["id"] for item in answer["objects"]]

    assert objects() == [1]
    assert objects("--threshold", "0.01") == [1, 2]
    assert objects("--set", "canonical=object, red wall", "--set", "absent=zero") == []
    status, (answer,) = ask("query", walls, "red", "--preset", "paper")
    assert status == 0 and answer["uncalibrated"] == "canonical phrases of your own"
    _, (answer,) = ask("query", walls, "red plant wall in the quixotic sofa")
    assert (answer["read_as"], answer["unknown"]) == ("red wall", [])
    assert list(answer["unused"]) == ["plant", "in", "quixotic", "sofa"]


def test_a_text_that_is_refused_does_not_take_the_others_along(walls, ask, slg, refusal):
    status, answers = ask("query", walls, "red", "qwxyz", "not blue", "blue")
    assert status == 1
    assert [(a["text"], a["verdict"]) for a in answers] == [
        ("red", "not sure"), ("qwxyz", "cannot tell"), ("not blue", None), ("blue", "not sure"),
    ]  # fmt: skip
    assert [a["refused"] is None for a in answers] == [True, True, False, True]
    assert "qwxyz" in answers[1]["summary"] and "'not'" in answers[2]["refused"]
    status, rows = ask("objects", "list", walls, "red", "zeppelin", "blue")
    assert status == 1
    assert [row["words"] for row in rows if "id" in row] == [["red", "blue"], ["blue", "red"]]
    assert "zeppelin" in rows[-1]["refused"]
    status, rows = ask("segment", walls, "not green", "red", "blue")
    assert status == 1
    assert [(row["text"], row.get("label")) for row in rows] == [
        ("red", 2), ("blue", 3), (None, 0), ("not green", None),
    ]  # fmt: skip
    for command in (["query"], ["objects", "list"], ["segment"]):
        status, out, _ = slg(*command, walls, "red", "not green")
        assert status == 1 and "'not green' is refused: " in out
    error = refusal("query", walls, "not red", "not blue")
    assert "not red" in error and "not blue" in error


def test_where_nothing_is_found_there_is_no_point(walls, tmp_path, ask, slg):
    status, (answer,) = ask("query", walls, "yellow", "-o", tmp_path / "a.png")
    assert status == 3
    assert (answer["found"], answer["point"], answer["objects"]) == (False, None, [])
    assert 0 < answer["score"] < 0.5
    assert "not here: the best object scores 0." in slg("query", walls, "yellow")[1]
    # Neither is one drawn: the last panel is the rendering.
    slg("query", walls, "red", "-o", tmp_path / "b.png")
    for name, same in (("a", True), ("b", False)):
        picture = pixels(tmp_path / f"{name}.png")[12:44]
        assert np.array_equal(picture[:, 12:60], picture[:, 132:180]) == same
    # The best guess stays where it is asked for.
    field = SemanticField.load(walls)
    assert field.render(field.cameras[FIRST]).query("yellow").point is not None


def test_a_query_from_between_two_views(walls, ask):
    names = ["--between", "001", "1"]
    _, (middle,) = ask("query", walls, "red", *names, "0.5")
    assert middle["view"] == f"between {FIRST} and {SECOND} at 0.5"
    _, (first,) = ask("query", walls, "red")
    _, (second,) = ask("query", walls, "red", "--view", "1")
    # The second camera stands 0.2 to the right of a wall 2 away: the edge moves by 4 pixels.
    assert second["pixels"] < middle["pixels"] < first["pixels"]
    assert middle["pixels"] == pytest.approx((first["pixels"] + second["pixels"]) / 2, abs=32)
    for share, end in (("0", first), ("1", second)):
        _, (inside,) = ask("query", walls, "red", *names, share)
        assert {**inside, "view": end["view"]} == end


def test_a_camera_file_may_hold_one_camera_or_many(walls, tmp_path, ask, refusal):
    file, one = transforms(tmp_path, 0.1), tmp_path / "camera.json"
    _, (listed,) = ask("query", walls, "red", "--camera", file)
    assert listed["view"] == "new/007.png"
    item = json.loads(file.read_text())
    (frame,) = item.pop("frames")
    item["transform_matrix"] = frame["transform_matrix"]
    one.write_text(json.dumps(item))
    _, (alone,) = ask("query", walls, "red", "--camera", one)
    assert alone == {**listed, "view": "camera.json"}
    # It is OpenGL's: a camera that looks the other way sees nothing of the walls.
    item["transform_matrix"] = np.eye(4).tolist()
    one.write_text(json.dumps(item))
    status, (away,) = ask("query", walls, "red", "--camera", one)
    assert (status, away["found"], away["score"]) == (3, False, 0)
    assert away["summary"] == "not here: this view shows no object"
    del item["w"]
    one.write_text(json.dumps(item))
    error = refusal("query", walls, "red", "--camera", one)
    assert "frame 'camera.json': has neither w and h" in error


def test_a_segmentation_is_a_picture_an_id_map_and_a_table(walls, tmp_path, ask, slg):
    out = tmp_path / "labels.png"
    words = ["segment", walls, "blue", "green", "red", "-o", out]
    status, rows = ask(*words)
    assert status == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["labels.ids.png", "labels.png"]
    ids = read_ids(tmp_path / "labels.ids.png")
    field = SemanticField.load(walls)
    view = field.render(field.cameras[FIRST])
    np.testing.assert_array_equal(ids, view.segment(["blue", "green", "red"]))
    assert ids[16, 4] == 3 and ids[16, 44] == 1
    for row in rows:
        assert row["share"] == pytest.approx((ids == row["label"]).mean())
    assert [row["objects"] for row in rows] == [[2], [], [1], []]
    assert rows[1]["relevancy"] is None
    assert rows[0]["relevancy"] == pytest.approx(view.query("blue").scores[1], abs=1e-6)
    status, printed, _ = slg(*words)
    assert status == 0
    assert "    1  blue" in printed and str(tmp_path / "labels.ids.png") in printed
    assert Image.open(out).height > 12 + 32 + 34  # a legend below


def test_render_and_export_write_their_files(walls, tmp_path, slg):
    words = ["--view", "1", "--depth", tmp_path / "depth.npy", "--ids", tmp_path / "ids.png"]
    assert slg("render", walls, "-o", tmp_path / "seen.png", *words)[0] == 0
    assert slg("export", walls, "-o", tmp_path / "scene.ply", "--full")[0] == 0
    assert slg("export", walls, "-o", tmp_path / "plain.ply")[0] == 0
    assert slg("export", walls, "-o", tmp_path / "scene.glb")[0] == 0
    assert len(list(tmp_path.iterdir())) == 6
    field = SemanticField.load(walls)
    view = field.render(field.cameras[SECOND])
    assert np.array_equal(pixels(tmp_path / "seen.png"), view.rgb)
    assert np.array_equal(np.load(tmp_path / "depth.npy"), view.depth)
    assert np.array_equal(pixels(tmp_path / "ids.png"), view.ids)
    output, extra = load_ply(tmp_path / "scene.ply")
    assert torch.equal(output.features, field.gaussians.features)
    assert torch.equal(output.source, field.gaussians.source)
    is_red = (np.arange(32 * 48) % 48) < 24
    assert extra["label"].tolist() == np.where(is_red, 1, 2).tolist()
    plain, extra = load_ply(tmp_path / "plain.ply")
    assert torch.equal(plain.means, output.means) and plain.features is None and extra == {}
    data = (tmp_path / "scene.glb").read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert content["nodes"][0]["extras"]["objects"] == {"1": "red", "2": "blue"}


def test_codes_are_drawn_as_the_papers_feature_maps(walls, tmp_path, slg):
    """Every pixel is the code of its object times its light (equation 3), as colours."""
    field = SemanticField.load(walls)
    assert slg("render", walls, "-o", tmp_path / "a.png", "--show", "codes")[0] == 0
    drawn = pixels(tmp_path / "a.png")
    view = field.render(field.cameras[FIRST])
    sure = (view.confidence > 0.9) & (view.alpha > 0.99)
    codes = field.bank.codes[np.searchsorted(field.bank.ids, view.ids[sure])]
    size = codes.shape[1]
    assert sure.mean() > 0.5 and not drawn[..., size:].any()
    assert np.abs(drawn[sure][:, :size] - 255 * codes).max() <= 0.1 * 255


def test_a_film_follows_a_turn_or_a_camera_path_of_nerfstudio(walls, tmp_path, slg):
    field = SemanticField.load(walls)
    first = field.cameras[FIRST]
    fov = np.degrees(2 * np.arctan(first.height / 2 / first.K[1, 1]))
    pose = (first.c2w * [1, -1, -1, 1]).ravel().tolist()
    content = {"render_width": first.width, "render_height": first.height}
    content["camera_path"] = [{"camera_to_world": pose, "fov": fov, "aspect": 1}]
    (tmp_path / "path.json").write_text(json.dumps(content))
    points = field.gaussians.means.numpy()
    turn = orbit(list(field.cameras.values()), points, 5)
    for way, value, cameras in (
        ("--orbit", "5", turn),
        ("--path", tmp_path / "path.json", [first]),
    ):
        film = tmp_path / "film" / "a.mp4"
        film.parent.mkdir(exist_ok=True)
        assert slg("render", walls, way, value, "-o", film)[0] == 0
        assert [file.name for file in film.parent.iterdir()] == [film.name]
        reader, frames = cv2.VideoCapture(str(film)), []
        while (read := reader.read())[0]:
            frames.append(read[1][..., ::-1].astype(int))
        for frame, camera in zip(frames, cameras, strict=True):
            assert np.abs(frame - field.render(camera).rgb).mean() < 12


@pytest.mark.parametrize("suffix", READERS)
def test_render_draws_a_file_of_gaussians_from_given_cameras(walls, tmp_path, slg, suffix):
    loaded = SemanticField.load(walls).gaussians
    sh = torch.zeros(len(loaded), 4, 3)
    sh[:, :1] = loaded.sh
    sh[:, 3, 1] = -1.0  # greener to the right of the camera, by 0.49 * x of the direction
    save_gaussians(replace(loaded, sh=sh), scene := tmp_path / f"scene{suffix}")
    inputs = ["--cameras", transforms(tmp_path), "--view", "007", "--depth", tmp_path / "a.npy"]
    done = slg("render", scene, *inputs, "-o", tmp_path / "a.png")
    assert done == (0, f"{tmp_path / 'a.png'}\n", "")
    observed = pixels(tmp_path / "a.png")
    # There the wall is 0.8125 to the right at a depth of 2: x of the direction is 0.376.
    assert np.abs(observed[32, 80] - np.array([0.05, 0.1 + 0.4886 * 0.376, 0.8]) * 255).max() <= 6
    assert np.abs(observed[32, 16] - np.array([0.8, 0, 0.05]) * 255).max() <= 4  # clamped at 0
    assert np.load(tmp_path / "a.npy")[32, 16] == pytest.approx(2, abs=0.05)


def test_a_field_that_cannot_be_used_is_to_be_built_again(walls, tmp_path, monkeypatch, refusal):
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")  # a view that was asked before is not read
    copy = shutil.copytree(walls, tmp_path / "damaged")
    data = (copy / "gaussians.npz").read_bytes()
    (copy / "gaussians.npz").write_bytes(data[: len(data) // 2])
    error = refusal("query", copy, "red")
    assert "gaussians.npz" in error and "build the field again" in error
    field = SemanticField.load(walls)
    wide = np.pad(field.bank.features, ((0, 0), (0, 0), (0, 1)))
    wider = replace(field.bank, features=wide)
    for settings, bank in (
        ({}, field.bank), ({"encoder": ["lexicon"]}, field.bank), ({"encoder": "lexicon"}, wider),
    ):  # fmt: skip
        replace(field, bank=bank, settings=settings).save(tmp_path / "field")
        assert "build the field again" in refusal("query", tmp_path / "field", "red")


def test_a_store_that_cannot_be_is_one_sentence(tmp_path, monkeypatch, refusal):
    (tmp_path / "file").write_text("in the way")
    config = tmp_path / "run.toml"
    config.write_text('[[scenes]]\nname="a"\ncontext=["1","2"]')
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.delenv("PREFECT_HOME", raising=False)
    for store, sentence in [("foo://x", "store foo://x"), (tmp_path / "file", "file/.prefect")]:
        assert sentence in refusal("run", config, "--store", store)


def test_words_lists_the_vocabulary_by_family(slg):
    status, out, _ = slg("words")
    lines = dict(line.split(": ", 1) for line in out.splitlines())
    assert status == 0 and "red (crimson" in lines["colour"] and "ball (sphere" in lines["solid"]
