"""Settings of presets, files and options: precedence, base of paths, misspelt keys."""

import tomllib
from pathlib import Path

import pytest

from flows import config as settings_module
from flows.benchmark import find_scenes
from flows.config import PRESETS, TABLES, CorpusSettings, Method, Settings, TrainSettings
from flows.read_config import make_settings, read_toml, validate_settings
from slgaussian.errors import InputError

FOLDER = Path(settings_module.__file__).parent / "presets"


@pytest.fixture
def file(tmp_path) -> Path:
    return tmp_path / "run.toml"


def select_method(values: dict) -> dict:
    return make_settings(values, "test").model_dump(include=set(Method.model_fields))


def test_preset_paper_has_training_of_the_paper():
    """Implementation Details: 80,000 iterations, a batch of 1, mask identifiers as they are."""
    values = {"preset": "paper", "lessons": "corpus", "out": "out"}
    chosen = validate_settings(TrainSettings, values, "train")
    assert (chosen.steps, chosen.batch, chosen.codes) == (80_000, 1, "grid")
    assert validate_settings(TrainSettings, {**values, "steps": 5}, "train").steps == 5
    with pytest.raises(InputError, match="found 'fast', expected 'paper'"):
        validate_settings(TrainSettings, {**values, "preset": "fast"}, "train")


@pytest.mark.parametrize("name", PRESETS)
def test_preset_has_only_settings_that_the_chosen_components_use(name):
    values = tomllib.loads((FOLDER / f"{name}.toml").read_text("utf-8"))
    assert set(values) <= set(Method.model_fields)
    chosen = make_settings({"preset": name}, "test")
    assert chosen.preset == name
    assert select_method({"preset": name}) == select_method(values)
    chosen.field_method.check()
    # Nothing in it is idle.
    assert values.keys() & TABLES.keys() <= {component.table for component in chosen.components}


def test_options_win_over_file_and_file_over_preset_key_by_key(file):
    fast = make_settings({"preset": "fast"}, "test")
    local = {"planesweep": {"depth_candidates": 100}}
    mixed = make_settings({"preset": "fast", **local}, "test")
    assert (mixed.size, mixed.planesweep.depth_candidates) == (fast.size, 100)
    file.write_text('preset = "fast"\nseed = 3\n')
    read = read_toml(file, {})
    assert (read.size, read.seed, read.replicas) == (fast.size, 3, Settings().replicas)
    # A file wins over a preset, wherever that is named, and an option over both.
    file.write_text('size = "96x64"\n')
    assert read_toml(file, {"preset": "fast"}).size == (96, 64)
    assert read_toml(file, {"preset": "fast", "size": "auto"}).size == "auto"
    # Its tables are as those of a file: that of a part which is not chosen lies idle.
    second = make_settings({"preset": "fast", "predictor": "mvsplat"}, "test")
    assert "planesweep" not in {component.name for component in second.components}


def test_paths_in_file_are_relative_to_its_folder(file, tmp_path):
    scene = '[[scenes]]\nname = "a"\npath = "photos"\ncontext = ["1", "2"]\n'
    file.write_text(f'store = "store"\nsize = [64, 96]\n{scene}')
    read = read_toml(file, {"size": "original"})
    assert read.store == str(tmp_path / "store")
    assert (read.scenes[0].path, read.size) == (tmp_path / "photos", "original")
    other = ["/elsewhere", "s3://bucket/chunks", "procedural:0-3"]
    file.write_text(f'out = "out"\nsources = {["kitchen", "office=walk", *other]}\n')
    read = read_toml(file, {}, CorpusSettings)
    assert read.sources == [f"{tmp_path}/kitchen", f"office={tmp_path}/walk", *other]


COMPONENTS = """
predictor = "mvsplat"
tracker = "sam2-video"
[mvsplat]
checkpoint = "weights/re10k.ckpt"
precision = "bfloat16"
[clip]
model = "clip.bin"
tokenizer = "a/b"
[sam]
model = "weights"
[sam2]
model = "facebook/sam2.1-hiera-tiny"
[sam2_video]
model = "weights"
batch = 4
[precomputed]
folder = "ids"
"""


def test_paths_in_component_table_are_relative_and_hub_names_stay(file, tmp_path):
    (tmp_path / "weights").mkdir()
    (tmp_path / "clip.bin").touch()
    file.write_text(COMPONENTS)
    read = read_toml(file, {"mvsplat": {"precision": "float32"}})
    weights = str(tmp_path / "weights")
    checkpoint = tmp_path / "weights/re10k.ckpt"
    assert read.mvsplat.model_dump() == {"checkpoint": checkpoint, "precision": "float32"}
    assert (read.clip.model, read.clip.tokenizer) == (str(tmp_path / "clip.bin"), "a/b")
    assert (read.sam.model, read.sam2.model) == (weights, "facebook/sam2.1-hiera-tiny")
    assert dict(read.configure("tracker")) == {"model": weights, "batch": 4}
    assert read.precomputed.folder == tmp_path / "ids"
    other = {"mvsplat": {"checkpoint": "elsewhere.ckpt"}}
    assert read_toml(file, other).mvsplat.checkpoint == Path("elsewhere.ckpt")
    # A file may keep the table of a part that is not chosen; an option without effect is a slip.
    assert read_toml(file, {"predictor": "planesweep"}).configure("predictor").name == "planesweep"
    with pytest.raises(InputError, match="settings of 'mvsplat' are given, but no component is"):
        read_toml(file, {"predictor": "planesweep", **other})


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("replica = 5", "unknown key 'replica'; did you mean 'replicas'\\?"),
        ('[[scenes]]\nname = "a"\ncontex = []', r"scenes.0: unknown key 'contex'; .*context"),
        ('[[scenes]]\nname = "a"', "scenes.0: context is missing"),
        ('[[scenes]]\nname="a"\ncontext=["1"]', "context: .*expected a list of at least 2"),
        ("replicas = 0", "replicas: found 0, expected a whole number from 1"),
        ('size = "abc"', "size: found 'abc'; expected height and width"),
        ('runner = "dask"', "port; give the address of the running cluster, as dask://host:8786"),
        ("threshold = 2", "threshold: found 2, expected a number from 0 below 1"),
        ("out = 3", "out: found 3, expected a path"),
        ("seed = ", "not valid TOML"),
        (2 * '[[scenes]]\nname = "a"\ncontext = ["1", "2"]\n', "two scenes are called 'a'"),
    ],
)
def test_invalid_configuration_is_refused_in_one_sentence(file, text, sentence):
    file.write_text(text)
    with pytest.raises(InputError, match=sentence) as error:
        read_toml(file, {})
    assert "run.toml" in str(error.value)


def test_scene_with_name_of_room_raises_input_error():
    scene = {"name": "room_3", "context": ["1", "2"]}
    with pytest.raises(InputError, match="two scenes are called 'room_3'"):
        find_scenes(make_settings({"rooms": "3-3", "scenes": [scene]}, "test"))
