"""MVSplat by command and by flow, its weights made by a recipe: what people meet, end to end."""

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from command import ROOM, run, save_photographs, score
from pipelines import calls_of, keyed

from benches.predict.random_mvsplat_weights import recipe_weights
from flows.config import TABLES, Settings
from flows.read_config import make_settings, read_toml
from flows.scene import scene_task
from slgaussian import datasets
from slgaussian.components.component import Component
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply
from slgaussian.rasterize import harmonics
from slgaussian.storage.store import ArtifactStore
from tasks.artifacts import sample_to_arrays
from tasks.context import RunContext
from tasks.scene import geometry

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "recipe.ckpt"
    torch.save(recipe_weights(), path)
    return path


@pytest.fixture(scope="module")
def digest(checkpoint) -> str:
    return hashlib.sha256(checkpoint.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    """Two photographs of 90 x 70 pixels, of which MVSplat takes the middle 80 x 64."""
    return save_photographs(tmp_path_factory.mktemp("photos"), height=70, width=90)


def field_words(photos: Path, *words) -> list:
    pair = (photos / "view_00.png", photos / "view_02.png")
    return ["field", *pair, "--cameras", photos, "--set", "near=0.8", *words]


def test_field_with_a_checkpoint(photos, checkpoint, digest, tmp_path, monkeypatch):
    inputs = ["--predictor", "mvsplat", "--set", f"mvsplat.checkpoint={checkpoint}"]
    inputs += ["--set", "mvsplat.depth_candidates=auto", "-o", tmp_path / "field"]
    assert run(monkeypatch, *field_words(photos, *inputs)) == 0
    field = SemanticField.load(tmp_path / "field")
    assert field.settings["predictor"] == "mvsplat"
    local = {"checkpoint": digest, "precision": "float32", "depth_candidates": "auto"}
    assert field.settings["mvsplat"] == local
    assert str(checkpoint.parent) not in (tmp_path / "field" / "field.json").read_text()

    # Pixels at the edge have no Gaussian, and all of the others have one.
    view, pixel = np.divmod(field.gaussians.source.numpy(), 70 * 90)
    row, column = np.divmod(pixel, 90)
    assert np.bincount(view).tolist() == [64 * 80] * 2
    assert (row.min(), row.max(), column.min(), column.max()) == (3, 66, 5, 84)

    # What other programs read shows the same colours, from anywhere.
    assert run(monkeypatch, "export", tmp_path / "field", "-o", tmp_path / "scene.ply") == 0
    read, _ = load_ply(tmp_path / "scene.ply")
    camera = field.cameras["view_00.png"]
    observed = harmonics.colors(field.gaussians, camera)
    torch.testing.assert_close(harmonics.colors(read, camera), observed, rtol=0, atol=1e-6)
    assert (observed - field.gaussians.colors()).abs().max() > 0.01
    words = ["render", tmp_path / "field", "-o", tmp_path / "seen.png"]
    assert run(monkeypatch, *words) == 0


NOT_WEIGHTS = "<html>Sign in to download</html>"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--predictor", "mvsplat"], "mvsplat checkpoint: none given; download re10k.ckpt"),
        (
            ["--predictor", "mvsplat", "--set", "mvsplat.checkpoint=none.ckpt"],
            "there is no such file",
        ),
        (
            ["--predictor", "mvsplat", "--set", "mvsplat.checkpoint=page.ckpt"],
            "page.ckpt: is damaged",
        ),
        (
            ["--set", "mvsplat.precision=bfloat16"],
            "but no part is 'mvsplat' (found predictor 'planes",
        ),
        (
            [
                "--predictor",
                "mvsplat",
                "--set",
                "mvsplat.precision=half",
                "--set",
                "mvsplat.checkpoint=SMALL",
            ],
            "mvsplat precision: found 'half', expected one of float32, bfloat16",
        ),
        (
            ["--predictor", "mvsplat", "--set", "mvsplat.depth_candidates=129"]
            + ["--set", "mvsplat.checkpoint=SMALL"],
            "mvsplat depth_candidates: found 129, expected 2 to 128 or",
        ),
    ],
)
def test_field_that_cannot_be_ends_in_one_sentence(
    photos, checkpoint, tmp_path, monkeypatch, capsys, words, sentence
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.ckpt").write_text(NOT_WEIGHTS)
    words = [word.replace("SMALL", str(checkpoint)) for word in words]
    assert run(monkeypatch, *field_words(photos, *words, "-o", "field")) == 2
    message = [n for n in capsys.readouterr().err.splitlines() if not n.startswith("building")]
    assert len(message) == 1
    assert message[0].startswith("error: ")
    assert sentence in message[0]
    assert [path.name for path in tmp_path.iterdir()] == ["page.ckpt"]


@pytest.mark.parametrize("broken", [None, "none.ckpt", "page.ckpt"])
def test_a_run_without_its_checkpoint_does_not_begin(tmp_path, monkeypatch, capsys, broken):
    (tmp_path / "page.ckpt").write_text(NOT_WEIGHTS)
    table = "" if broken is None else f'[mvsplat]\ncheckpoint = "{broken}"\n'
    config = toml(tmp_path, f'predictor = "mvsplat"\n{table}{SCENE}')
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")  # never asked
    assert run(monkeypatch, "run", config, "--store", tmp_path / "store") == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert "checkpoint" in message
    assert broken is None or str(tmp_path / broken) in message
    assert message.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.ckpt", "run.toml"]


SCENE = '[[scenes]]\nname = "a"\ncontext = ["1", "2"]\n'


def toml(folder: Path, text: str) -> Path:
    (folder / "run.toml").write_text(text)
    return folder / "run.toml"


def test_a_table_has_its_paths_from_its_folder_and_options_win(tmp_path):
    table = '[mvsplat]\ncheckpoint = "weights/re10k.ckpt"\nprecision = "bfloat16"\n'
    path = toml(tmp_path, f'predictor = "mvsplat"\n{table}{SCENE}')
    read = read_toml(path, {"mvsplat": {"precision": "float32", "depth_candidates": "64"}})
    assert read.mvsplat == TABLES["mvsplat"](
        checkpoint=tmp_path / "weights/re10k.ckpt", precision="float32", depth_candidates=64
    )
    inputs = {"checkpoint": "elsewhere.ckpt"}
    assert read_toml(path, {"mvsplat": inputs}).mvsplat.checkpoint == Path("elsewhere.ckpt")
    # A file may keep the table of a part that is not chosen; an option without effect is a slip.
    assert "mvsplat" not in read_toml(path, {"predictor": "planesweep"}).component_values()
    with pytest.raises(InputError, match="settings of 'mvsplat' are given, but no part is"):
        read_toml(path, {"predictor": "planesweep", "mvsplat": inputs})


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("mvsplat = 3", "mvsplat: found 3; expected a table"),
        (
            "[mvsplat]\ndepth_candidates = 64.5",
            "mvsplat depth_candidates: found 64.5, expected a whole number from 2 or 'auto'",
        ),
        ("[mvsplat]\ncheckpoint = 3", "mvsplat checkpoint: found 3, expected a path"),
        (
            '[mvsplat]\nweights = "re10k.ckpt"',
            "unknown key 'mvsplat.weights'; the keys are checkpoint, precision, depth_candidates$",
        ),
    ],
)
def test_a_slip_in_a_table_is_one_sentence(tmp_path, table, sentence):
    with pytest.raises(InputError, match=sentence):
        read_toml(toml(tmp_path, f"{table}\n"), {})


def settings_for(checkpoint: Path, out: Path, **local) -> Settings:
    table = {"checkpoint": checkpoint, "depth_candidates": "auto", **local}
    values = {"size": "64x64", "near": 0.8, "predictor": "mvsplat", "mvsplat": table}
    return make_settings({**values, "scenes": [ROOM], "out": out}, "test")


def test_a_run_is_known_by_the_content_of_its_checkpoint(
    checkpoint, digest, tmp_path, server, capsys
):
    store = ArtifactStore(tmp_path / "store")
    finished = score(settings_for(checkpoint, tmp_path / "out"), store)
    assert [result.scene for result in finished.results] == ["room"]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert f'settings.mvsplat.checkpoint</td><td class=" left">{digest}</td>' in page
    assert 'settings.mvsplat.depth_candidates</td><td class=" left">auto</td>' in page
    message = capsys.readouterr().err
    assert message.startswith("with mvsplat, regions, geometric, lexicon, separated, hard\n")

    # The same weights in another place: nothing is computed. Another setting: the geometry is.
    moved = tmp_path / "moved.ckpt"
    shutil.copy(checkpoint, moved)
    score(settings_for(moved, tmp_path / "again"), store)
    assert "room  geometry  cached" in capsys.readouterr().err
    assert (
        page.split("<h2>")[:-1]
        == ((tmp_path / "again" / "report.html").read_text("utf-8").split("<h2>")[:-1])
    )
    score(settings_for(moved, tmp_path / "third", depth_candidates=2), store)
    message = capsys.readouterr().err
    assert "room  ingest  cached" in message
    assert "room  geometry  cached" not in message
    # No artifact and no record says where the weights are.
    for file in Path(store.path).rglob("*"):
        assert not file.is_file() or str(checkpoint.parent).encode() not in file.read_bytes()


def test_settings_of_mvsplat_are_in_no_key_of_another_predictor(
    tmp_path, checkpoint, digest, monkeypatch
):
    scene = make_settings({"scenes": [ROOM]}, "test").scenes[0]
    stored = toml(tmp_path, f'[mvsplat]\ncheckpoint = "{tmp_path / "missing.ckpt"}"\n')

    def calls(settings):
        return calls_of(scene_task(settings, settings.built_by, scene), monkeypatch)

    plain, waiting = (calls(settings) for settings in (Settings(), read_toml(stored, {})))
    assert plain == waiting
    steps = calls(settings_for(checkpoint, tmp_path))
    assert keyed(plain["geometry"])["predictor"] == {"planesweep": {"depth_candidates": 144}}
    local = {"checkpoint": digest, "precision": "float32", "depth_candidates": "auto"}
    assert keyed(steps["geometry"])["predictor"] == {"mvsplat": local}
    assert steps["geometry"]["predictor"].places() == {"checkpoint": str(checkpoint)}
    assert keyed(steps["field"])["method"]["mvsplat"] == local
    for stage in ("masks", "supervision"):
        assert keyed(steps[stage]) == keyed(plain[stage])


def test_a_checkpoint_that_changes_during_a_run_is_refused(tmp_path, checkpoint, digest):
    store = ArtifactStore(tmp_path / "store")
    room = datasets.load("procedural", seed=1, objects=4, views=3, height=64, width=64)
    sample = store.put("sample", sample_to_arrays(room.sample(["view_00", "view_02"], near=0.8)))
    local = {"checkpoint": digest, "precision": "float32", "depth_candidates": 8}
    context, identity = RunContext(store), {"predictor": "mvsplat", "mvsplat": local}

    def made(place):
        predictor = Component.stored("predictor", identity, {"checkpoint": str(place)})
        return geometry.compute(context, sample, predictor, 0)

    assert made(checkpoint).meta["gaussians"] == 2 * 64 * 64
    second = tmp_path / "other.ckpt"
    second.write_bytes(checkpoint.read_bytes()[:-1])
    with pytest.raises(InputError, match="was changed after the run had begun"):
        made(second)
