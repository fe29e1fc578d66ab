"""Named settings: each is valid, what is given besides wins, and what ran is what is recorded."""

import tomllib
from pathlib import Path

import pytest

from flows import config as settings_module
from flows.config import PRESETS, TABLES, CorpusSettings, Method, TrainSettings
from flows.read_config import checked, make_settings, read_toml
from slgaussian.errors import InputError

FOLDER = Path(settings_module.__file__).parent / "presets"


def values_of(name: str) -> dict:
    return tomllib.loads((FOLDER / f"{name}.toml").read_text("utf-8"))


def method_of(values: dict) -> dict:
    return make_settings(values, "test").model_dump(include=set(Method.model_fields))


def test_the_papers_training_is_a_preset():
    """Implementation Details: 80,000 iterations, a batch of 1, mask identifiers as they are."""
    values = {"preset": "paper", "lessons": "corpus", "out": "out"}
    chosen = checked(TrainSettings, values, "train")
    assert (chosen.steps, chosen.batch, chosen.codes) == (80_000, 1, "grid")
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


def test_sources_in_a_file_are_relative_to_it(tmp_path):
    other = ["/elsewhere", "s3://bucket/chunks", "procedural:0-3"]
    (tmp_path / "run.toml").write_text(
        f'out = "out"\nsources = {["kitchen", "office=walk", *other]}\n'
    )
    read = read_toml(tmp_path / "run.toml", {}, CorpusSettings)
    assert read.sources == [f"{tmp_path}/kitchen", f"office={tmp_path}/walk", *other]
