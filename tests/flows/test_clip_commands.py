"""CLIP and named vectors by command and by flow, with small random weights."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import command
import numpy as np
import pytest
from command import room_sample, run, said, save_photographs, score
from pipelines import calls_of, keyed

from flows.config import Settings
from flows.read_config import make_settings, read_toml
from flows.scene import scene_task
from slgaussian.build import build_field
from slgaussian.components.component import Component
from slgaussian.components.method import Method
from slgaussian.components.pretrained import model_digest
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.language.configs import CLIP
from slgaussian.storage.store import ArtifactStore
from tasks.artifacts import sample_to_arrays
from tasks.context import RunContext
from tasks.scene import geometry, masks, supervision
from tests.language.small_clip import save_clip

ROOM = {**command.ROOM, "queries": ["red basket"]}

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    return save_clip(tmp_path_factory.mktemp("models") / "clip")


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    return save_photographs(tmp_path_factory.mktemp("photos"))


def settings_for(model: Path, out: Path, **local) -> Settings:
    values = {"size": "64x64", "near": 0.8, "far": 12.0, "encoder": "clip", "replicas": 1}
    table = {"model": str(model), **local}
    return make_settings({**values, "clip": table, "scenes": [ROOM], "out": out}, "test")


@pytest.fixture(scope="module")
def output(model, photos, tmp_path_factory) -> Path:
    """A field that ``slgaussian field`` built with CLIP."""
    folder = tmp_path_factory.mktemp("made") / "field"
    words = ["field", photos / "view_00.png", photos / "view_02.png", "--cameras", photos]
    words += [
        "--set",
        "near=0.8",
        "--set",
        "far=12",
        "--set",
        "replicas=1",
        "--encoder",
        "clip",
        "--set",
        f"clip.model={model}",
    ]
    with pytest.MonkeyPatch.context() as patch:
        assert run(patch, *words, "--set", "clip.crops=context", "-o", folder) == 0
    return folder


def test_a_field_knows_its_model_by_content_and_where_it_was(output, model):
    info = json.loads((output / "field.json").read_text())
    assert info["settings"]["encoder"] == "clip"
    assert info["settings"]["clip"] == {
        "model": model_digest(model),
        "tokenizer": None,
        "crops": "context",
        "batch": 4,
        "precision": "float32",
    }
    assert info["places"] == {"model": str(model.resolve())}
    assert str(model) not in json.dumps(info["settings"])
    bank = SemanticField.load(output).bank
    assert bank.features.shape[1:] == (2, 24)


def test_a_field_answers_with_the_same_model(output, model, monkeypatch, capsys, tmp_path):
    assert run(monkeypatch, "query", output, "red basket", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert 0 < answer["score"] < 1 and answer["unknown"] == [] and answer["point"] is not None

    # The model has moved: the field still draws, and is asked with the place.
    moved = shutil.copytree(model, tmp_path / "moved")
    info = json.loads((output / "field.json").read_text())
    info["places"] = {"model": str(tmp_path / "gone")}
    field = shutil.copytree(output, tmp_path / "field")
    (field / "field.json").write_text(json.dumps(info))
    assert run(monkeypatch, "render", field, "-o", tmp_path / "seen.png") == 0
    capsys.readouterr()
    assert run(monkeypatch, "query", field, "red basket") == 2
    sentence = said(capsys)
    assert "encoder 'clip' needs its model, which is not stored with a field and is" in sentence
    assert f"no longer at {tmp_path / 'gone'}; say where it is, as in --set clip.model=" in sentence
    assert (
        run(monkeypatch, "query", field, "red basket", "--json", "--set", f"clip.model={moved}")
        == 0
    )
    assert json.loads(capsys.readouterr().out) == answer
    assert (
        run(monkeypatch, "objects", "list", field, "red", "box", "--set", f"clip.model={moved}")
        == 0
    )


def test_another_model_is_refused(output, model, tmp_path, monkeypatch, capsys):
    second = shutil.copytree(model, tmp_path / "other")
    config = json.loads((second / "config.json").read_text())
    (second / "config.json").write_text(json.dumps({**config, "note": 1}))
    assert run(monkeypatch, "query", output, "red", "--set", f"clip.model={second}") == 2
    assert f"model {second}: is not what the field was built with" in said(capsys)
    assert run(monkeypatch, "query", output, "red", "--set", "clip.model=no/such/place") == 2
    assert "model no/such/place: there is no such folder" in said(capsys)
    assert run(monkeypatch, "query", output, "word " * 100) == 2
    assert "tokens, but the model reads at most 77" in said(capsys)


def test_from_python_too(model, tmp_path, monkeypatch):
    local = {"clip": {"model": model}}
    field = build_field(room_sample(), Method(encoder="clip", replicas=1, settings=local))
    camera = field.cameras["view_00"]
    hit = field.render(camera).query("red basket")
    field.save(tmp_path / "field")
    assert field.settings["clip"]["model"] == model_digest(model)
    moved = shutil.copytree(model, tmp_path / "moved")
    info = json.loads((tmp_path / "field" / "field.json").read_text())
    (tmp_path / "field" / "field.json").write_text(json.dumps({**info, "places": {}}))
    loaded = SemanticField.load(tmp_path / "field", encoder={"model": moved})
    rerun = loaded.render(camera).query("red basket")
    assert np.array_equal(rerun.scores, hit.scores)
    silent = SemanticField.load(tmp_path / "field")
    with pytest.raises(InputError, match="needs its model, which is not stored with a field; say"):
        silent.render(camera).query("red basket")
    with pytest.raises(InputError, match=r"unknown key 'clip\.weights'"):
        replace(loaded, places={**loaded.places, "weights": str(moved)}).encoder  # noqa: B018


def test_the_model_by_default_is_written_down_too(model, tmp_path, monkeypatch):
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    place = tmp_path / f"models--{CLIP.replace('/', '--')}"
    (place / "refs").mkdir(parents=True)
    (place / "refs" / "main").write_text("0" * 40)
    shutil.copytree(model, place / "snapshots" / ("0" * 40))
    field = build_field(room_sample(), Method(encoder="clip", replicas=1))
    assert field.settings["clip"]["model"] == model_digest(model)
    assert field.places == {"model": CLIP}


def test_a_run_is_known_by_the_content_of_its_model(model, tmp_path, server, capsys):
    store = ArtifactStore(tmp_path / "store")
    finished = score(settings_for(model, tmp_path / "out"), store)
    assert [result.scene for result in finished.results] == ["room"]
    rows = finished.results[0].rows
    assert all(row["score"] is not None for row in rows) and len(rows) >= 2
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert f'settings.clip.model</td><td class=" left">{model_digest(model)}</td>' in page
    assert "clip" in capsys.readouterr().err.splitlines()[0]

    # The same model in another place: nothing is computed. Other crops: the bank is.
    moved = shutil.copytree(model, tmp_path / "moved")
    score(settings_for(moved, tmp_path / "again"), store)
    assert "room  benchmark  cached" in capsys.readouterr().err
    # The field is asked with the model where each run had it.
    for out, place in (("out", model), ("again", moved)):
        field = SemanticField.load(tmp_path / out / "fields" / "room")
        assert field.places == {"model": str(place.resolve())}
        assert field.describe(["red ball"])
    score(settings_for(moved, tmp_path / "third", crops="context"), store)
    progress = capsys.readouterr().err
    assert "room  masks  cached" in progress and "room  supervision  cached" not in progress
    for file in Path(store.path).rglob("*"):
        assert not file.is_file() or str(model).encode() not in file.read_bytes()


def test_settings_of_a_model_are_in_the_keys_of_its_own_stages(model, tmp_path, monkeypatch):
    settings = settings_for(model, tmp_path)
    scene = settings.scenes[0]
    steps = calls_of(scene_task(settings, settings.built_by, scene), monkeypatch)
    local = {"model": model_digest(model), "tokenizer": None, "crops": "masked", "batch": 4}
    local["precision"] = "float32"
    assert keyed(steps["supervision"])["encoder"] == {"clip": local}
    assert keyed(steps["field"])["method"]["clip"] == local
    for stage in ("supervision", "benchmark"):
        assert steps[stage]["encoder"].places() == {"model": str(model.resolve())}
    plain = calls_of(scene_task(Settings(), Method(), scene), monkeypatch)
    assert keyed(plain["geometry"])["predictor"] == keyed(steps["geometry"])["predictor"]
    assert plain["supervision"]["encoder"].places() == {}
    assert "clip" not in keyed(plain["field"])["method"]


def test_a_model_that_changes_during_a_run_is_refused(model, tmp_path):
    store = ArtifactStore(tmp_path / "store")
    context, method = RunContext(store), Method(codes="grid")
    sample = store.put("sample", sample_to_arrays(room_sample()))
    base = geometry.compute(context, sample, method.predictor, 0)
    ids = masks.compute(context, sample, base, method.proposer, method.tracker, 1, "views")
    local = {"encoder": "clip", "clip": {"model": model_digest(model)}}

    def remembered(place):
        encoder = Component.stored("encoder", local, {"model": str(place)})
        return supervision.compute(context, sample, base, ids, encoder, method.codes, 0, "groups")

    assert remembered(model).meta["objects"] >= 1
    second = shutil.copytree(model, tmp_path / "other")
    (second / "merges.txt").write_text(
        (second / "merges.txt").read_text("utf-8") + "x y\n", "utf-8"
    )
    with pytest.raises(InputError, match="was changed after the run had begun"):
        remembered(second)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["--set", "encoder=clip", "--set", "clip.model=no/such/folder"],
            "there is no such folder",
        ),
        (
            ["--set", "encoder=clip", "--set", "clip.model=CLIP", "--set", "clip.crops=x"],
            "crops: found 'x'",
        ),
        (
            ["--set", "encoder=clip", "--set", "clip.model=CLIP", "--set", "clip.batch=0"],
            "batch: found 0",
        ),
        (["--set", "clip.batch=2"], "settings of 'clip' are given, but no part is 'clip'"),
    ],
)
def test_a_run_that_cannot_be_does_not_begin(model, tmp_path, monkeypatch, capsys, words, sentence):
    config = tmp_path / "run.toml"
    config.write_text('[[scenes]]\nname = "a"\ncontext = ["1", "2"]\n')
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")  # never asked
    words = [word.replace("CLIP", str(model)) for word in words]
    assert run(monkeypatch, "run", config, "--store", tmp_path / "store", *words) == 2
    assert sentence in said(capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["run.toml"]


def test_files_beside_the_configuration_are_found_and_a_name_is_left(tmp_path):
    (tmp_path / "clip.bin").touch()
    config = tmp_path / "run.toml"
    config.write_text('[clip]\nmodel = "clip.bin"\ntokenizer = "a/b"\n')
    read = read_toml(config, {})
    assert read.clip.model == str(tmp_path / "clip.bin")
    assert read.clip.tokenizer == "a/b"
