"""Named settings: each is valid, what is given besides wins, and what ran is what is recorded."""

import tomllib
from pathlib import Path

import pytest
from command import run, said, save_photographs

from flows import config as settings_module
from flows.config import PRESETS, TABLES, Method, Settings, TrainSettings
from flows.read_config import checked, make_settings, read_toml
from slgaussian.errors import InputError
from slgaussian.field import SemanticField

FOLDER = Path(settings_module.__file__).parent / "presets"


def values_of(name: str) -> dict:
    return tomllib.loads((FOLDER / f"{name}.toml").read_text("utf-8"))


def method_of(values: dict) -> dict:
    return make_settings(values, "test").model_dump(include=set(Method.model_fields))


def test_there_is_a_file_for_every_name_and_no_other():
    names = {f"{name}.toml" for name in PRESETS} | {"train_paper.toml"}
    assert {file.name for file in FOLDER.iterdir()} == names


def test_the_papers_training_is_a_preset():
    """Implementation Details: 80,000 iterations, a batch of 1, mask identifiers as they are."""
    values = {"preset": "paper", "lessons": "corpus", "out": "out"}
    chosen = checked(TrainSettings, values, "train")
    printed = chosen.architecture, chosen.steps, chosen.batch, chosen.codes, chosen.corrupted
    assert printed == ("paper", 80_000, 1, "grid", 0)
    assert checked(TrainSettings, {**values, "steps": 5}, "train").steps == 5
    with pytest.raises(InputError, match="found 'fast', expected one of paper"):
        checked(TrainSettings, {**values, "preset": "fast"}, "train")


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_has_settings_of_the_method_alone_and_its_parts_take_them(name):
    values = values_of(name)
    assert set(values) <= set(Method.model_fields)
    for table in values.keys() & TABLES.keys():
        assert set(values[table]) <= set(TABLES[table].model_fields)
    chosen = make_settings({"preset": name}, "test")
    assert chosen.preset == name
    assert method_of({"preset": name}) == method_of(values)
    chosen.built_by.check()
    # Nothing in it is idle.
    assert values.keys() & TABLES.keys() <= chosen.component_values().keys()


def test_presets_differ_and_balanced_is_the_defaults():
    methods = [method_of({"preset": name}) for name in PRESETS]
    assert all(a != b for i, a in enumerate(methods) for b in methods[:i])
    assert method_of({"preset": "balanced"}) == method_of({})


def test_what_is_given_wins_key_by_key(tmp_path):
    fast = make_settings({"preset": "fast"}, "test")
    local = {"planesweep": {"depth_candidates": 100}}
    mixed = make_settings({"preset": "fast", **local}, "test")
    assert (mixed.size, mixed.planesweep.depth_candidates) == (fast.size, 100)
    file = tmp_path / "run.toml"
    file.write_text('preset = "fast"\nseed = 3\n')
    read = read_toml(file, {})
    assert (read.size, read.seed) == (fast.size, 3)
    # A file wins over a preset, wherever that is named, and an option over both.
    file.write_text('size = "96x64"\n')
    assert read_toml(file, {"preset": "fast"}).size == (96, 64)
    assert read_toml(file, {"preset": "fast", "size": "auto"}).size == "auto"
    # Its tables are as those of a file: that of a part which is not chosen lies idle.
    second = make_settings({"preset": "fast", "predictor": "mvsplat"}, "test")
    assert "planesweep" not in second.component_values()


@pytest.mark.parametrize("result", ["quick", "accurate", 3, ["fast"]])
def test_a_preset_that_is_not_there_is_one_sentence(result):
    with pytest.raises(InputError, match=r"found .*, expected one of fast, balanced, paper"):
        make_settings({"preset": result}, "test")


def test_a_field_says_what_ran(tmp_path, monkeypatch, capsys):
    photos = save_photographs(tmp_path)
    pair = photos / "view_00.png", photos / "view_02.png"
    words = ["field", *pair, "--cameras", photos, "--set", "near=0.8", "--set", "far=12"]
    assert run(monkeypatch, *words, "--preset", "fast", "-o", tmp_path / "field") == 0
    field = SemanticField.load(tmp_path / "field")
    chosen = make_settings({"preset": "fast"}, "test")
    assert field.settings["planesweep"] == chosen.planesweep.model_dump()
    assert {
        name: field.settings[name] for name in chosen.component_names()
    } == chosen.component_names()
    assert field.settings["replicas"] == chosen.replicas
    capsys.readouterr()
    assert run(monkeypatch, *words, "--preset", "quick", "-o", tmp_path / "other") == 2
    assert "expected one of fast, balanced, paper" in said(capsys)


@pytest.mark.parametrize(
    ("size", "stored"),
    [("at most 312x432", "at most 312x432"), ("at most 0312x432", "at most 312x432")],
)
def test_a_size_may_be_a_bound(size, stored):
    assert make_settings({"size": size}, "test").size == stored


@pytest.mark.parametrize("size", ["at most", "at most 3x4", "at most 312", "atmost 312x432"])
def test_a_bound_that_is_none_is_one_sentence(size):
    with pytest.raises(InputError, match=r"size: found .*expected height and width as in 256x256"):
        make_settings({"size": size}, "test")


def test_no_preset_is_the_default():
    assert Settings().preset is None
