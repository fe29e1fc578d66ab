"""SAM and SAM 2 by command and by flow, with small random weights made here: end to end."""

import json
import shutil
from pathlib import Path

import pytest
from command import ROOM, room_sample, run, score
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
from slgaussian.storage.store import ArtifactStore
from tasks.artifacts import sample_to_arrays
from tasks.context import RunContext
from tasks.scene import geometry, masks
from tests.masks.small_models import save_sam, save_sam2

OWN = {"preset": "langsplat", "points": 3}


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("models")
    return {"sam": save_sam(root / "sam"), "sam2": save_sam2(root / "sam2")}


def settings_for(folder: Path, out: Path, proposer: str = "sam", **local) -> Settings:
    table = {"model": str(folder), **OWN, **local}
    values = {"size": "64x64", "near": 0.8, "far": 12.0, "proposer": proposer, proposer: table}
    return make_settings({**values, "scenes": [ROOM], "out": out}, "test")


@pytest.mark.parametrize("name", ["sam", "sam2"])
def test_a_field_says_which_model_made_its_masks(folders, tmp_path, name):
    local = {name: {"model": folders[name], **OWN}}
    field = build_field(room_sample(), Method(proposer=name, replicas=1, settings=local))
    field.save(tmp_path / "field")
    message = SemanticField.load(tmp_path / "field").settings
    assert message["proposer"] == name
    complete = {**message[name], "model": model_digest(folders[name]), **OWN}
    assert message[name] == complete
    assert str(folders[name]) not in (tmp_path / "field" / "field.json").read_text()


def test_a_run_is_known_by_the_content_of_its_model(folders, tmp_path, server, capsys):
    store = ArtifactStore(tmp_path / "store")
    finished = score(settings_for(folders["sam"], tmp_path / "out"), store)
    assert [result.scene for result in finished.results] == ["room"]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    digest = model_digest(folders["sam"])
    assert f'settings.sam.model</td><td class=" left">{digest}</td>' in page
    assert capsys.readouterr().err.startswith("with planesweep, sam, ")
    records = [
        json.loads(file.read_text())
        for file in (Path(store.path) / "keys" / "masks").rglob("*")
        if file.is_file()
    ]
    assert [r["meta"]["settings"]["proposer"]["sam"]["model"] for r in records] == [digest]

    # The same model in another place: nothing is computed. Another setting: the masks are.
    moved = shutil.copytree(folders["sam"], tmp_path / "moved")
    score(settings_for(moved, tmp_path / "again"), store)
    assert "room  masks  cached" in capsys.readouterr().err
    score(settings_for(moved, tmp_path / "third", points=2), store)
    message = capsys.readouterr().err
    assert "room  geometry  cached" in message and "room  masks  cached" not in message
    for file in Path(store.path).rglob("*"):
        assert not file.is_file() or str(folders["sam"]).encode() not in file.read_bytes()


def test_settings_of_a_model_are_in_the_keys_of_its_own_stage(folders, tmp_path, monkeypatch):
    scene = make_settings({"scenes": [ROOM]}, "test").scenes[0]
    settings = settings_for(folders["sam2"], tmp_path, "sam2")
    steps = calls_of(scene_task(settings, settings.built_by, scene), monkeypatch)
    local = {"model": model_digest(folders["sam2"]), **OWN, "level": "all", "batch": 16}
    assert keyed(steps["masks"])["proposer"] == {"sam2": local}
    assert keyed(steps["field"])["method"]["sam2"] == local
    assert steps["masks"]["proposer"].places() == {"model": str(folders["sam2"])}
    plain = calls_of(scene_task(Settings(), Method(), scene), monkeypatch)
    assert keyed(plain["masks"])["proposer"] == {"regions": {}}
    assert keyed(plain["supervision"]) == keyed(steps["supervision"])
    assert plain["geometry"]["predictor"] == steps["geometry"]["predictor"]


def test_a_model_that_changes_during_a_run_is_refused(folders, tmp_path):
    store = ArtifactStore(tmp_path / "store")
    context, method = RunContext(store), Method(tracker="geometric")
    sample = store.put("sample", sample_to_arrays(room_sample()))
    base = geometry.compute(context, sample, method.predictor, 0)
    local = {"proposer": "sam", "sam": {"model": model_digest(folders["sam"]), **OWN}}

    def labelled(place):
        proposer = Component.stored("proposer", local, {"model": str(place)})
        return masks.compute(context, sample, base, proposer, method.tracker, 1, "views")

    assert labelled(folders["sam"]).meta["objects"] >= 1
    second = shutil.copytree(folders["sam"], tmp_path / "other")
    config = json.loads((second / "config.json").read_text())
    (second / "config.json").write_text(json.dumps({**config, "note": 1}))
    with pytest.raises(InputError, match="was changed after the run had begun"):
        labelled(second)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["--set", "proposer=sam"],
            "sam model: none given; give a folder, or a name on the hub as",
        ),
        (["--set", "proposer=sam", "--set", "sam.model=no/such/folder"], "there is no such folder"),
        (["--set", "proposer=sam2", "--set", "sam2.model=SAM"], "is of type 'sam', but sam2 needs"),
        (
            ["--set", "proposer=sam", "--set", "sam.model=SAM", "--set", "sam.preset=x"],
            "preset: found 'x'",
        ),
        (["--set", "sam.points=4"], "settings of 'sam' are given, but no part is 'sam'"),
        (["--set", "proposer=sam", "--set", "sam.points=few"], "sam points: found 'few'"),
    ],
)
def test_a_run_that_cannot_be_does_not_begin(
    folders, tmp_path, monkeypatch, capsys, words, sentence
):
    config = tmp_path / "run.toml"
    config.write_text('[[scenes]]\nname = "a"\ncontext = ["1", "2"]\n')
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")  # never asked
    words = [word.replace("SAM", str(folders["sam"])) for word in words]
    assert run(monkeypatch, "run", config, "--store", tmp_path / "store", *words) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and message.count("\n") == 1
    assert sentence in message
    assert [path.name for path in tmp_path.iterdir()] == ["run.toml"]


def test_a_folder_beside_the_configuration_is_found_and_a_name_is_left(tmp_path):
    (tmp_path / "weights").mkdir()
    config = tmp_path / "run.toml"
    config.write_text('[sam]\nmodel = "weights"\n[sam2]\nmodel = "facebook/sam2.1-hiera-tiny"\n')
    read = read_toml(config, {})
    assert read.sam.model == str(tmp_path / "weights")
    assert read.sam2.model == "facebook/sam2.1-hiera-tiny"
