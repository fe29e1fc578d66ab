"""The field on a scene with an exact truth: a wall of three colours, and a square before it."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage

from slgaussian.build import build_field
from slgaussian.errors import InputError, SpecError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.scene import Estimated
from tests.square import BLUE, COLOURS, GREEN, RED, YELLOW, camera, looked, square_field

NEW = camera(0.05)
true_ids, true_depth = looked(NEW)
AWAY = ndimage.maximum_filter(true_ids, 7) == ndimage.minimum_filter(true_ids, 7)
"""Where no border of two objects mixes their light."""


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return square_field("grid")


def test_a_new_view_shows_the_right_colours_ids_and_depth(field):
    seen = field.render(NEW)
    assert (seen.ids == true_ids)[AWAY].all()
    colours = np.array([COLOURS[label] for label in true_ids[AWAY]])
    assert np.abs(seen.rgb[AWAY].astype(int) - colours).max() <= 2
    assert np.abs(seen.depth - true_depth)[AWAY].max() < 1e-3


def test_words_find_their_part(field):
    seen = field.render(NEW)
    for text, label in (("red", RED), ("blue wall", BLUE), ("yellow", YELLOW)):
        hit, truth = seen.query(text), true_ids == label
        assert (hit.mask & truth).sum() / (hit.mask | truth).sum() > 0.8
        assert true_ids[hit.point[1], hit.point[0]] == label == hit.objects[0][0]
    segments = seen.segment(["blue", "red"])
    for label, word in ((BLUE, 1), (RED, 2)):
        assert (segments == word)[AWAY & (true_ids == label)].mean() > 0.97
    words = {thing.id: thing.words[0][0] for thing in field.inventory(["blue", "red"])}
    assert (words[RED], words[BLUE]) == ("red", "blue")


def test_arguments_of_the_wrong_type_are_refused(field, tmp_path):
    view = field.render(NEW)
    for call, message in [
        (lambda: field.render("a.jpg"), "render: expected a Camera.*found a str"),
        (lambda: view.query(["red", "blue"]), "query: expected one text.*found a list"),
        (lambda: field.query("red", threshold=2), "threshold"),
        (lambda: build_field(["a.jpg", "b.jpg"]), "build_field: expected a Sample.*found a list"),
        (lambda: save_ply(str(tmp_path / "x.ply"), field.gaussians), "save_ply: expected Gauss"),
    ]:
        with pytest.raises(InputError, match=message):
            call()


def test_cameras_that_were_found_say_so_in_a_saved_field(field, tmp_path):
    said = Estimated((0.9, 1.2), "EXIF", 0.8)
    cameras = {**field.cameras, "a": replace(field.cameras["a"], estimated=said)}
    replace(field, cameras=cameras).save(tmp_path / "field")
    again = SemanticField.load(tmp_path / "field")
    assert [again.cameras[name].estimated for name in "ab"] == [said, None]
    file = tmp_path / "field/field.json"
    content = json.loads(file.read_text())
    assert "estimated" not in content["cameras"]["b"]
    content["cameras"]["a"]["estimated"]["confidence"] = 7
    file.write_text(json.dumps(content))
    with pytest.raises(SpecError, match=r"damaged .*estimated"):
        SemanticField.load(tmp_path / "field")


def test_saving_twice_gives_the_same_bytes_which_say_what_they_are(field, tmp_path):
    for name in ("one", "two", "two"):
        field.save(tmp_path / name)
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()
    about = json.loads((tmp_path / "one/field.json").read_text())
    assert about["format"] == 1 and about["made_by"].startswith("slgaussian ")
    assert about["settings"] == field.settings and list(about["cameras"]) == ["a", "b"]
    files = {file.name for file in (tmp_path / "one").iterdir()}
    assert {*about["files"], "field.json"} == files


@pytest.mark.parametrize("codes", ["grid", "separated"])
def test_every_kind_of_code_says_the_same_and_keeps_it_on_disk(codes, tmp_path):
    made = square_field(codes)
    made.save(tmp_path / "field")
    again = SemanticField.load(tmp_path / "field")
    seen, loaded = made.render(NEW), again.render(NEW)
    assert seen.confidence.dtype == np.float32
    for name in ("rgb", "ids", "confidence", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(loaded, name))
    assert (seen.ids == true_ids)[AWAY].all()
    assert seen.confidence[AWAY].min() > 0.9 and seen.confidence[~AWAY].min() < 0.5
    np.testing.assert_array_equal(made.labels(), again.labels())
    assert set(np.unique(made.labels())) == {RED, GREEN, BLUE, YELLOW}
    table = again.objects()
    assert table.column("id").to_pylist() == [RED, GREEN, BLUE, YELLOW]
    np.testing.assert_array_equal(table.column("code_b"), made.bank.codes[:, 2])
    assert sum(table.column("gaussians").to_pylist()) == len(made.gaussians)
    assert seen.query("red").objects[0][0] == RED
    wrong = torch.zeros(len(made.gaussians), 7)
    replace(made, gaussians=replace(made.gaussians, features=wrong)).save(tmp_path / "spoilt")
    with pytest.raises(SpecError, match=r"gaussians\.npz: .*features"):
        SemanticField.load(tmp_path / "spoilt")


def test_a_folder_that_is_no_field_is_left_alone(field, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for folder, sentence in (
        (tmp_path, "is not a field"),
        (tmp_path / "notes.txt/field", "cannot be written"),
    ):
        with pytest.raises(InputError, match=sentence):
            field.save(folder)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("name", ["gaussians.npz", "bank.npz", "field.json"])
def test_damage_is_named(field, tmp_path, name):
    field.save(tmp_path / "field")
    file = tmp_path / "field" / name
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(SpecError, match=name.replace(".", r"\.")):
        SemanticField.load(tmp_path / "field")
    file.unlink()
    with pytest.raises(SpecError, match=name.replace(".", r"\.")):
        SemanticField.load(tmp_path / "field")


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"cameras": None}, "damaged"),
        ({"places": {"model": 3}}, "damaged .a place is not text"),
        ({"files": {"gaussians.npz": "../../etc"}}, "damaged"),
        ({"format": None}, "format: found none.*expected 1; build the field again"),
        ({"format": 9, "made_by": "slgaussian 9"}, "format: found 9, made by slgaussian 9, expect"),
    ],
)
def test_a_description_that_cannot_be_used_is_named(field, tmp_path, changed, sentence):
    field.save(tmp_path / "field")
    about = tmp_path / "field" / "field.json"
    about.write_text(json.dumps(json.loads(about.read_text()) | changed))
    with pytest.raises(SpecError, match=rf"field\.json: {sentence}"):
        SemanticField.load(tmp_path / "field")


def test_files_of_two_fields_are_not_mixed(field, tmp_path):
    field.save(tmp_path / "field")
    moved = replace(field.gaussians, means=field.gaussians.means + 1)
    replace(field, gaussians=moved).save(tmp_path / "other")
    shutil.copy(tmp_path / "other" / "gaussians.npz", tmp_path / "field")
    with pytest.raises(SpecError, match=r"gaussians\.npz: digest: .*another field"):
        SemanticField.load(tmp_path / "field")
