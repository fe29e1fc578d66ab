import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from command import run, said, transforms, two_walls
from PIL import Image

from flows.config import Settings
from flows.read_config import read_toml
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.language.bank import MemoryBank


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    return two_walls(tmp_path_factory.mktemp("cli") / "field")


def test_query_finds_the_red_wall(field, tmp_path, monkeypatch, capsys):
    picture = tmp_path / "hit.png"
    assert run(monkeypatch, "query", field, "red", "-o", picture, "--json") == 3
    answer = json.loads(capsys.readouterr().out)
    assert answer["objects"][0]["id"] == 1
    assert answer["point"][0] < 24
    assert answer["pixels"] == pytest.approx(32 * 24, abs=64)
    assert answer["view"] == "images/001.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert run(monkeypatch, "query", field, "blue", "--view", "002") == 3
    assert "objects  2 (" in capsys.readouterr().out


def test_several_texts_and_views_are_answered_in_turn(field, tmp_path, monkeypatch, capsys):
    words = ["query", field, "red", "blue", "--view", "0", "--view", "002"]
    assert run(monkeypatch, *words, "--json", "-o", tmp_path / "a.png") == 3
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    calls = [(a["text"], a["view"], a["objects"][0]["id"]) for a in answers]
    first, second = "images/001.png", "images/002.png"
    assert calls == [("red", first, 1), ("blue", first, 2), ("red", second, 1), ("blue", second, 2)]
    assert run(monkeypatch, "query", field, "red", "-o", tmp_path / "b.png") == 3
    assert Image.open(tmp_path / "a.png").height == 4 * Image.open(tmp_path / "b.png").height
    capsys.readouterr()
    assert run(monkeypatch, *words) == 3
    assert "'blue' in images/002.png" in capsys.readouterr().out


def test_a_query_follows_its_rules(field, monkeypatch, capsys):
    def objects(*words):
        status = run(monkeypatch, "query", field, "red", "--json", *words)
        answer = json.loads(capsys.readouterr().out)
        assert status == (0 if answer["found"] else 3)
        return [item["id"] for item in answer["objects"]]

    assert objects() == [1]
    assert objects("--threshold", "0.01") == [1, 2]
    assert objects("--set", "canonical=object, red wall", "--set", "absent=zero") == []


def test_a_store_that_cannot_be_is_one_sentence(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("in the way")
    config = toml(tmp_path, '[[scenes]]\nname="a"\ncontext=["1","2"]')
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.delenv("PREFECT_HOME", raising=False)
    for store, sentence in [("foo://x", "store foo://x"), (tmp_path / "file", "file/.prefect")]:
        assert run(monkeypatch, "run", config, "--store", store) == 2
        assert sentence in said(capsys)


def test_render_and_export_write_their_files(field, tmp_path, monkeypatch):
    words = ["--view", "1", "--depth", tmp_path / "depth.npy", "--ids", tmp_path / "ids.png"]
    assert run(monkeypatch, "render", field, "-o", tmp_path / "seen.png", *words) == 0
    assert run(monkeypatch, "export", field, "-o", tmp_path / "scene.ply") == 0
    assert len(list(tmp_path.iterdir())) == 4
    opened = SemanticField.load(field)
    view = opened.render(list(opened.cameras.values())[1])
    assert np.array_equal(np.asarray(Image.open(tmp_path / "seen.png")), view.rgb)
    assert np.array_equal(np.load(tmp_path / "depth.npy"), view.depth)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "ids.png")), view.ids)
    output, extra = load_ply(tmp_path / "scene.ply")
    stored = SemanticField.load(field).gaussians
    assert torch.equal(output.features, stored.features)
    assert torch.equal(output.source, stored.source)
    is_red = (np.arange(32 * 48) % 48) < 24
    assert extra["label"].tolist() == np.where(is_red, 1, 2).tolist()


def test_codes_are_drawn_as_the_papers_feature_maps(field, tmp_path, monkeypatch):
    """Every pixel is the code of its object times its light (equation 3), as colours."""
    own = SemanticField.load(field)
    assert run(monkeypatch, "render", field, "-o", tmp_path / "a.png", "--show", "codes") == 0
    drawn = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    seen = own.render(next(iter(own.cameras.values())))
    sure = (seen.confidence > 0.9) & (seen.alpha > 0.99)
    codes = own.bank.codes[np.searchsorted(own.bank.ids, seen.ids[sure])]
    assert sure.mean() > 0.5
    size = codes.shape[1]
    assert (
        np.abs(drawn[sure][:, :size] - 255 * codes).max() <= 0.1 * 255
        and not drawn[..., size:].any()
    )


def test_a_film_follows_a_camera_path_of_nerfstudio(field, tmp_path, monkeypatch):
    local = SemanticField.load(field)
    first = next(iter(local.cameras.values()))
    fov = np.degrees(2 * np.arctan(first.height / 2 / first.K[1, 1]))
    frames = [
        {"camera_to_world": (first.c2w * [1, -1, -1, 1]).ravel().tolist(), "fov": fov, "aspect": 1}
    ]
    content = {"render_width": first.width, "render_height": first.height, "camera_path": frames}
    (tmp_path / "path.json").write_text(json.dumps(content))
    words = ["--path", tmp_path / "path.json", "-o", tmp_path / "a.mp4"]
    assert run(monkeypatch, "render", field, *words) == 0
    frame = cv2.VideoCapture(str(tmp_path / "a.mp4")).read()[1][..., ::-1].astype(int)
    assert np.abs(frame - local.render(first).rgb).mean() < 12


def test_a_ply_is_rendered_from_cameras_that_are_given(field, tmp_path, monkeypatch, capsys):
    loaded = SemanticField.load(field).gaussians
    sh = torch.zeros(len(loaded), 4, 3)
    sh[:, :1] = loaded.sh
    sh[:, 3, 1] = -2.0  # greener to the right of the camera, by 0.49 * 2 * x of the direction
    save_ply(replace(loaded, sh=sh), tmp_path / "scene.ply")
    inputs = ["--cameras", transforms(tmp_path), "--view", "007", "--depth", tmp_path / "a.npy"]
    assert (
        run(monkeypatch, "render", tmp_path / "scene.ply", *inputs, "-o", tmp_path / "a.png") == 0
    )
    message = capsys.readouterr()
    assert (message.out.strip(), message.err) == (str(tmp_path / "a.png"), "")
    observed = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    # There the wall is 0.8125 to the right at a depth of 2: x of the direction is 0.376.
    assert np.abs(observed[32, 80] - np.array([0.05, 0.1 + 0.9772 * 0.376, 0.8]) * 255).max() <= 6
    assert np.abs(observed[32, 16] - np.array([0.8, 0, 0.05]) * 255).max() <= 4  # clamped at 0
    assert np.load(tmp_path / "a.npy")[32, 16] == pytest.approx(2, abs=0.05)


def test_a_damaged_field_is_one_sentence(field, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")  # a view that was asked before is not read
    copy = shutil.copytree(field, tmp_path / "field")
    data = (copy / "gaussians.npz").read_bytes()
    (copy / "gaussians.npz").write_bytes(data[: len(data) // 2])
    assert run(monkeypatch, "query", copy, "red") == 2
    message = said(capsys)
    assert "gaussians.npz" in message and "build the field again" in message


@pytest.mark.parametrize(
    ("settings", "width"), [({}, 0), ({"encoder": ["lexicon"]}, 0), ({"encoder": "lexicon"}, 1)]
)
def test_a_field_of_another_encoder_is_one_sentence(
    field, tmp_path, monkeypatch, capsys, settings, width
):
    loaded = SemanticField.load(field)
    bank = loaded.bank
    wider = np.pad(bank.features, ((0, 0), (0, 0), (0, width)))
    bank = MemoryBank(bank.ids, bank.codes, wider, bank.present)
    SemanticField(loaded.gaussians, bank, loaded.cameras, settings).save(tmp_path / "field")
    assert run(monkeypatch, "query", tmp_path / "field", "red") == 2
    assert "build the field again" in said(capsys)


def toml(tmp_path, text):
    path = tmp_path / "run.toml"
    path.write_text(text)
    return path


def test_a_configuration_is_read_with_paths_from_its_folder(tmp_path):
    path = toml(
        tmp_path,
        'store = "kept"\nreplicas = 3\nsize = [64, 96]\n'
        '[[scenes]]\nname = "a"\npath = "photos"\ncontext = ["1", "2"]\n',
    )
    settings = read_toml(path, {"replicas": 4, "size": "original"})
    assert settings.store == str(tmp_path / "kept")
    assert settings.scenes[0].path == tmp_path / "photos"
    assert (settings.replicas, settings.size) == (4, "original")
    assert settings.seed == Settings().seed


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("replica = 5", "unknown key 'replica'; did you mean 'replicas'\\?"),
        ('[[scenes]]\nname = "a"\ncontex = []', r"scenes.0: unknown key 'contex'; .*context"),
        ('[[scenes]]\nname = "a"', "scenes.0: context is missing"),
        ("replicas = 0", "replicas: found 0, expected a whole number from 1"),
        ('size = "abc"', "size: found 'abc'; expected height and width"),
        ("threshold = 2", "threshold: found 2, expected a number from 0 below 1"),
        ("out = 3", "out: found 3, expected a path"),
        (
            '[[scenes]]\nname="a"\ncontext=["1"]',
            "context: .*expected a list of at least 2",
        ),
        ("seed = ", "not valid TOML"),
        (
            '[[scenes]]\nname="a"\ncontext=["1","2"]\n[[scenes]]\nname="a"\ncontext=["1","2"]',
            "two scenes are called 'a'",
        ),
    ],
)
def test_a_slip_in_a_configuration_is_one_sentence(tmp_path, text, sentence):
    with pytest.raises(InputError, match=sentence) as error:
        read_toml(toml(tmp_path, text), {})
    assert "run.toml" in str(error.value)


def test_words_lists_the_vocabulary_by_family(monkeypatch, capsys):
    assert run(monkeypatch, "words") == 0
    lines = dict(line.split(": ", 1) for line in capsys.readouterr().out.splitlines())
    assert "red (crimson" in lines["colour"]
    assert "ball (sphere" in lines["solid"]
