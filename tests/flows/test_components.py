"""Components with weights or files of their own, by command and by flow, with small real models."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import command
import numpy as np
import pytest
import torch
from command import room_sample, run, save_photographs, score, settings

from benches.predict.random_mvsplat_weights import recipe_weights
from flows.config import Settings
from flows.read_config import make_settings
from flows.runners.batches import SceneTask
from flows.scene import scene_task
from slgaussian import datasets
from slgaussian.components.pretrained import model_digest
from slgaussian.field import SemanticField
from slgaussian.masks.configs import folder_digest, geometry_digest
from slgaussian.scene import View
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.stage import Stage, canonical
from tests.language.small_clip import save_clip
from tests.masks.small_models import save_sam, save_sam2
from tests.program_outputs import write_da3_cli, write_predictions

pytestmark = pytest.mark.usefixtures("one_thread")

ROOM = {**command.ROOM, "queries": ["red basket"]}
SIZE = 192, 256
"""Height and width of the photographs whose depth is given."""


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    """Two photographs of 90 x 70 pixels, of which MVSplat takes the middle 80 x 64."""
    return save_photographs(tmp_path_factory.mktemp("photos"), height=70, width=90)


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> dict[str, Path]:
    """Weights or files by the name of their component; ``depth`` is of precomputed geometry."""
    root = tmp_path_factory.mktemp("models")
    torch.save(recipe_weights(), root / "recipe.ckpt")
    (root / "ids").mkdir()
    for view in room_sample().context:
        np.save(root / "ids" / f"{view.name}.npy", view.instances)
    return {
        "mvsplat": root / "recipe.ckpt",
        "sam": save_sam(root / "sam"),
        "sam2": save_sam2(root / "sam2"),
        "clip": save_clip(root / "clip"),
        "precomputed": root / "ids",
    }


def hash_files(name: str, place: Path) -> str:
    if name == "mvsplat":
        return hashlib.sha256(place.read_bytes()).hexdigest()
    return folder_digest(place) if name == "precomputed" else model_digest(place)


SAM = {"preset": "sam", "points": 3}
CASES = {
    # Name: kind, the setting that names its files, other settings, those that its identity adds.
    "mvsplat": ("predictor", "checkpoint", {"precision": "bfloat16"}, {}),
    "sam": ("proposer", "model", SAM, {"level": "all", "batch": 16}),
    "sam2": ("proposer", "model", SAM, {"level": "all", "batch": 16}),
    "clip": (
        "encoder", "model", {},
        {"tokenizer": None, "crops": "masked", "batch": 4, "precision": "float32"},
    ),
    "precomputed": ("tracker", "folder", {}, {"geometry": None}),
}  # fmt: skip
STAGE_OF = {
    "predictor": "geometry",
    "proposer": "masks",
    "tracker": "masks",
    "encoder": "supervision",
}


def settings_for(places: dict[str, Path], *names: str, **values) -> Settings:
    """Return settings of the room with components."""
    for name in names:
        kind, setting, local, _ = CASES[name]
        values |= {kind: name, name: {setting: str(places[name]), **local, **values.get(name, {})}}
    common = {"size": "64x64", "near": 0.8, "far": 12.0, "replicas": 1, "scenes": [ROOM]}
    return make_settings({**common, **values}, "test")


def record_calls(
    scene_task: SceneTask, monkeypatch: pytest.MonkeyPatch
) -> dict[str, dict[str, Any]]:
    """Return the arguments of every stage of a pipeline by its name."""
    calls = {}

    def record(stage: Stage, *args, **kwargs) -> ArtifactRef:
        bound = stage.signature.bind(None, *args, **kwargs)
        bound.apply_defaults()
        _, *inputs = bound.arguments.items()
        calls[stage.name] = dict(inputs)
        return ArtifactRef(stage.name, f"{stage.name}/x", "x", {"targets": []})

    with monkeypatch.context() as patch:
        patch.setattr(Stage, "__call__", record)
        scene_task.pipeline(*scene_task.arguments)
    return calls


def select_keys(arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of a stage that are part of its cache key."""
    return {name: canonical(value, name) for name, value in arguments.items()}


@pytest.mark.parametrize("name", CASES)
def test_cache_key_of_stage_has_files_of_component_by_content(places, name, monkeypatch):
    kind, setting, local, added = CASES[name]
    chosen, default = settings_for(places, name), settings_for(places)
    steps, plain = (
        record_calls(scene_task(s, s.scenes[0]), monkeypatch) for s in (chosen, default)
    )
    identity = {setting: hash_files(name, places[name]), **local, **added}
    stage = STAGE_OF[kind]
    assert select_keys(steps[stage])[kind] == {name: identity}
    assert select_keys(steps["field"])["method"][name] == identity
    assert steps[stage][kind].places() == {setting: str(places[name])}
    changed = {stage for stage in plain if select_keys(plain[stage]) != select_keys(steps[stage])}
    assert changed - {"benchmark", "attribution"} == {stage, "field"}
    assert name not in select_keys(plain["field"])["method"] and plain[stage][kind].places() == {}


def test_run_is_cached_by_content_of_files_wherever_they_are(places, tmp_path, server, capsys):
    names = ("mvsplat", "sam", "clip")
    store = ArtifactStore(tmp_path / "store")
    finished = score(settings_for(places, *names, out=tmp_path / "out"), store)
    assert [result.scene for result in finished.results] == ["room"]
    assert all(row["score"] is not None for row in finished.results[0].rows)
    assert capsys.readouterr().err.startswith("with mvsplat, sam, geometric, clip, ")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    for name in names:
        setting = f"settings.{name}.{CASES[name][1]}"
        cell = f'{setting}</td><td data-head="" class=" left">{hash_files(name, places[name])}</td>'
        assert cell in page

    # The same files in another place: nothing is computed. Another setting: its stage is.
    (tmp_path / "moved").mkdir()
    moved = {name: tmp_path / "moved" / places[name].name for name in names}
    for name in names:
        copy = shutil.copytree if places[name].is_dir() else shutil.copy
        copy(places[name], moved[name])
    score(settings_for(moved, *names, out=tmp_path / "again"), store)
    assert "room  attribution  cached" in capsys.readouterr().err
    for out, files in (("out", places), ("again", moved)):
        field = SemanticField.load(tmp_path / out / "fields" / "room")
        assert field.places == {"model": str(files["clip"].resolve())}
        assert field.inventory(["red ball"])
    changed = settings_for(moved, *names, out=tmp_path / "third", sam={"points": 2})
    score(changed, store, verbose=True)
    progress = capsys.readouterr().err
    assert "room  geometry  cached" in progress and "room  masks  cached" not in progress
    # No artifact and no record says where the files are.
    for file in Path(store.path).rglob("*"):
        assert not file.is_file() or str(places["sam"].parent).encode() not in file.read_bytes()


def write_results(folder: Path, views: list[View]) -> Path:
    """Write an NPZ in the layout of Depth Anything 3."""
    arrays = {"depth": [v.depth for v in views], "conf": np.ones((2, *SIZE), np.float32)}
    arrays |= {"extrinsics": [v.camera.w2c[:3] for v in views]}
    np.savez(folder / "results.npz", **arrays, intrinsics=[v.camera.K for v in views])
    return folder / "results.npz"


@pytest.mark.parametrize(
    ("write", "given"),
    [
        (write_results, False),
        (lambda folder, views: write_da3_cli(folder / "depth", views), False),
        (lambda folder, views: write_predictions(folder / "a.npz", views, "vggt"), False),
        (lambda folder, views: write_predictions(folder / "a.npz", views, "mapanything"), True),
    ],
    ids=["Depth Anything 3", "depth-anything.cpp", "VGGT by ggml", "MapAnything by ggml"],
)
def test_field_is_built_from_depth_and_cameras_in_file(tmp_path, monkeypatch, write, given):
    views = [command.room(*SIZE).read(name) for name in ROOM["context"]]
    command.write_photographs(tmp_path, {f"{view.name}.png": view for view in views})
    place = write(tmp_path, views)
    words = ["--predictor", "precomputed", "--set", f"precomputed.geometry={place}"]
    words += ["--cameras", tmp_path] if given else []
    photos = [tmp_path / f"{view.name}.png" for view in views]
    assert run(monkeypatch, "field", *photos, *words, "-o", tmp_path / "field") == 0
    field = SemanticField.load(tmp_path / "field")
    assert field.settings["precomputed"]["geometry"] == geometry_digest(place)
    assert field.settings["quality"]["confirmed"] > 0.8
    for view in views:
        camera = field.cameras[f"{view.name}.png"]
        np.testing.assert_allclose(camera.c2w, view.camera.c2w, atol=1e-6)
        assert np.median(np.abs(field.render(camera).depth / view.depth - 1)) < 0.02


@pytest.mark.whole
def test_field_of_a_real_pair_is_built_from_numbered_views(real_data, tmp_path, monkeypatch):
    scene = datasets.load("nerfstudio", real_data / "office")
    views = [scene.read(f"images/{name}.png") for name in ("00346", "00348")]
    place = write_da3_cli(tmp_path / "depth", views)
    words = ["--predictor", "precomputed", "--set", f"precomputed.geometry={place}"]
    photos = [real_data / "office" / view.name for view in views]
    assert run(monkeypatch, "field", *photos, *words, "-o", tmp_path / "field") == 0
    field = SemanticField.load(tmp_path / "field")
    assert field.settings["quality"]["confirmed"] > 0.5
    for view, camera in zip(views, field.cameras.values(), strict=True):
        np.testing.assert_allclose(camera.c2w, view.camera.c2w, atol=1e-5)  # of 6 digits
        true = view.resize(camera.height, camera.width).depth
        off = np.abs(field.render(camera).depth / np.where(true > 0, true, 1) - 1)[true > 0]
        assert np.median(off) < 0.02


@pytest.fixture(scope="module")
def clip_field(places, photos, tmp_path_factory) -> Path:
    """A field that ``slgaussian field`` built with CLIP."""
    folder = tmp_path_factory.mktemp("made") / "field"
    pair = photos / "view_00.png", photos / "view_02.png", "--cameras", photos
    model = {"clip.model": places["clip"], "clip.crops": "context"}
    words = settings(near=0.8, far=12, replicas=1, encoder="clip", **model)
    with pytest.MonkeyPatch.context() as patch:
        assert run(patch, "field", *pair, *words, "-o", folder) == 0
    return folder


def test_field_is_queried_with_its_model_wherever_that_is(
    clip_field, places, ask, slg, refusal, tmp_path
):
    info = json.loads((clip_field / "field.json").read_text())
    assert info["settings"]["clip"]["model"] == model_digest(places["clip"])
    assert info["places"] == {"model": str(places["clip"].resolve())}
    assert SemanticField.load(clip_field).bank.features.shape[1:] == (2, 24)
    status, (answer,) = ask("query", clip_field, "red basket")
    assert status == 0 and 0 < answer["score"] < 1
    assert answer["unknown"] == [] and answer["point"] is not None

    # The model has moved: the field still draws, and is asked with the place.
    model = ["--set", f"clip.model={shutil.copytree(places['clip'], tmp_path / 'moved')}"]
    info["places"] = {"model": str(tmp_path / "gone")}
    field = shutil.copytree(clip_field, tmp_path / "field")
    (field / "field.json").write_text(json.dumps(info))
    assert slg("render", field, "-o", tmp_path / "seen.png")[0] == 0
    error = refusal("query", field, "red basket")
    assert f"no longer at {tmp_path / 'gone'}; say where it is, as in --set clip" in error
    assert ask("query", field, "red basket", *model) == (0, [answer])
    assert slg("objects", "list", field, "red", "box", *model)[0] == 0
    second = shutil.copytree(places["clip"], tmp_path / "second")
    config = json.loads((second / "config.json").read_text())
    (second / "config.json").write_text(json.dumps({**config, "note": 1}))
    for words, sentence in (
        (["red", *settings(**{"clip.model": second})], f"{second}: is not what the field was"),
        (["red", *settings(**{"clip.model": "no/where"})], "model no/where: there is no such"),
        (["word " * 100], "tokens, but the model reads at most 77"),
    ):
        assert sentence in refusal("query", clip_field, *words)


@pytest.mark.parametrize(
    ("assignments", "sentence"),
    [
        ("predictor=mvsplat", "mvsplat checkpoint: none given; download re10k.ckpt"),
        ("predictor=mvsplat mvsplat.checkpoint=page.ckpt", "page.ckpt: is damaged"),
        ("mvsplat.precision=bfloat16", "but no component is 'mvsplat' (found predictor 'planes"),
        ("encoder=clip clip.model=CLIP clip.crops=x", "crops: found 'x'"),
        ("proposer=sam", "sam model: none given; give a folder, or a name on the hub as"),
        ("proposer=sam2 sam2.model=SAM", "is of type 'sam', but sam2 needs"),
        ("proposer=sam sam.model=SAM sam.preset=x", "preset: found 'x'"),
        ("tracker=precomputed", "precomputed folder: none given"),
    ],
)
def test_run_with_unusable_component_does_not_begin(
    places, tmp_path, monkeypatch, refusal, assignments, sentence
):
    monkeypatch.chdir(tmp_path)
    Path("page.ckpt").write_text("<html>Sign in to download</html>")
    Path("run.toml").write_text('[[scenes]]\nname = "a"\ncontext = ["1", "2"]\n')
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")  # never asked
    for name in ("mvsplat", "clip", "sam"):
        assignments = assignments.replace(f"={name.upper()}", f"={places[name]}")
    words = [word for value in assignments.split() for word in ("--set", value)]
    assert sentence in refusal("run", "run.toml", "--store", "store", *words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.ckpt", "run.toml"]
