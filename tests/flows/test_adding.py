"""Photographs that are added to a field: as if all had been given at once, and cheaper."""

import json
import re
import shutil

import numpy as np
import pytest
from command import run, said, two_walls
from PIL import Image

from flows.cli.adding import _settled
from slgaussian import datasets
from slgaussian.cameras import kept_pairs
from slgaussian.cameras.kept_pairs import pair_pose
from slgaussian.cameras.pair import Described
from slgaussian.cameras.photograph import Photograph
from slgaussian.datasets import unposed
from slgaussian.field import SemanticField
from slgaussian.geometry import boundaries
from slgaussian.storage import origin as origins
from slgaussian.storage.derived import Derived, keeping

SIZE = 96, 128
NAMES = ["a.png", "b.png", "c.png", "d.png"]


def save_room(folder):
    """Four photographs of a made-up room, and ``transforms.json`` with their cameras."""
    scene = datasets.load("procedural", seed=0, objects=4, views=4, height=SIZE[0], width=SIZE[1])
    frames = []
    for name, file in zip(scene.cameras, NAMES, strict=True):
        camera = scene.cameras[name]
        Image.fromarray(scene.read(name).image).save(folder / file)
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        pose = (camera.c2w * [1, -1, -1, 1]).tolist()
        frame = {"file_path": file, "transform_matrix": pose, "fl_x": fx, "fl_y": fy}
        frames.append({**frame, "cx": cx, "cy": cy, "w": SIZE[1], "h": SIZE[0]})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))


NEAR = ["--near", "0.8", "--far", "12", "--replicas", "3", "--seed", "4"]
"""Settings that a field must keep when photographs are added."""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the photographs, and the fields of the first three and of all four."""
    folder = tmp_path_factory.mktemp("built")
    save_room(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        given = ["--cameras", "transforms.json", *NEAR]
        assert run(patch, "field", *NAMES[:3], *given, "-o", "three") == 0
        assert run(patch, "field", *NAMES, *given, "-o", "four") == 0
    return folder


@pytest.fixture
def place(built, tmp_path, monkeypatch):
    """The current folder: the field of three, whose photographs are elsewhere."""
    shutil.copytree(built / "three", tmp_path / "field")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def content(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def apart_from_ids(folder):
    """The content of a field, its bank in the order of codes and without the numbers of objects."""
    held = content(folder)
    bank = SemanticField.load(folder).bank
    order = np.lexsort(bank.codes.T)
    about = json.loads(held.pop("field.json"))
    for file in ("bank.npz", "objects.parquet"):
        held.pop(file), about["files"].pop(file)
    rows = [getattr(bank, name)[order] for name in ("codes", "features", "present", "boxes")]
    own = np.where(bank.levels < len(bank), -1, bank.levels)[:, order]
    return held, about, [array.tobytes() for array in (*rows, own, bank.group_features)]


def test_the_field_is_the_same_as_of_all_at_once(place, built, monkeypatch, capsys):
    outlined = []
    inner = boundaries._outlines
    monkeypatch.setattr(boundaries, "_outlines", lambda lab: outlined.append(lab) or inner(lab))
    before = content(place / "field")
    assert run(monkeypatch, "field", "--add", built / "d.png", "field", "-o", "other") == 0
    printed = capsys.readouterr()
    assert printed.out == "other\n"
    assert printed.err.endswith(
        "1 added; reused 3 of 4 features, 2 of 3 leaves, 3 of 6 matches, 3 of 4 outlines, 3 of 4 "
        "palettes, 0 of 4 sweeps\n"
    )
    assert len(outlined) == 1
    assert content(place / "field") == before
    assert apart_from_ids(place / "other") == apart_from_ids(built / "four")

    # In place, and without what was derived, which only saves time.
    (place / "field" / origins.DERIVED).write_bytes(b"damaged")
    assert run(monkeypatch, "field", "--add", built / "d.png", "field/") == 0
    assert re.search(r"1 added; reused (0 of \d \w+, ){5}0 of 4 sweeps\n$", capsys.readouterr().err)
    assert content(place / "field") == content(place / "other")
    assert {file.name for file in place.iterdir()} == {"field", "other"}


def test_photographs_are_added_one_after_the_other_or_together(place, built, monkeypatch, capsys):
    two = [built / name for name in NAMES[:2]]
    words = [*two, "--cameras", built / "transforms.json", *NEAR]
    assert run(monkeypatch, "field", *words, "-o", "two") == 0
    more = [built / name for name in NAMES[2:]]
    assert run(monkeypatch, "field", "--add", *more, "two", "-o", "together") == 0
    assert "2 added" in capsys.readouterr().err
    for photo in more:
        assert run(monkeypatch, "field", "--add", photo, "two") == 0
    at_once = apart_from_ids(built / "four")
    assert apart_from_ids(place / "two") == apart_from_ids(place / "together") == at_once
    field = SemanticField.load("two")
    assert list(field.cameras) == NAMES
    assert (field.settings["replicas"], field.settings["seed"]) == (3, 4)


def test_what_a_user_changed_goes_along(place, built, monkeypatch):
    before = SemanticField.load("field")
    objects = before.objects().sort_by([("gaussians", "descending")])
    first, other = objects["id"].to_pylist()[:2]
    changed = before.teach("zorp", first).named(other, "Mine").without([first])
    changed.save_edits("field")
    assert run(monkeypatch, "field", "--add", built / "d.png", "field") == 0
    after = SemanticField.load("field")
    assert "zorp" in after.taught and after.removed == {first}
    assert after.names == {other: "Mine"}
    # The hidden object is the one that it was.
    camera = after.cameras["a.png"]
    seen = after.restored([first]).render(camera).ids == first
    was = before.render(camera).ids == first
    assert (seen & was).sum() > 0.7 * was.sum()


def test_what_is_no_object_any_more_is_said(built, capsys):
    before = SemanticField.load(built / "three")
    named, hidden = before.bank.ids.tolist()[:2]
    before = before.named(named, "Mine").without([hidden])
    strangers = _settled(before, SemanticField.load(built / "four"), views={})
    assert not strangers.names and not strangers.removed
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith(f"object {named} ('Mine') is without its name: with the new")
    assert told[1].startswith(f"object {hidden} is shown again: with the new photographs it is")


def test_what_cannot_be_added_is_one_sentence_and_changes_nothing(
    place, built, monkeypatch, capsys
):
    image = np.asarray(Image.open(built / "d.png"))
    frames = json.loads((built / "transforms.json").read_text())["frames"]
    for frame in frames:
        frame["file_path"] = str(built / frame["file_path"])
    low = {**frames[3], "file_path": "low.png", "h": 80, "cy": frames[3]["cy"] - 8}
    Image.fromarray(image[8:88]).save("low.png")
    (place / "low.json").write_text(json.dumps({"frames": [*frames, low]}))
    (place / "few.json").write_text(json.dumps({"frames": frames[:3]}))
    (place / "scene.ply").write_bytes(b"ply\n")
    Image.fromarray(image[::-1]).save("stranger.png")
    two_walls(place / "walls")
    shutil.copytree("field", "newer")
    about = json.loads((place / "newer/field.json").read_text())
    (place / "newer/field.json").write_text(json.dumps({**about, "format": 9}))
    shutil.copytree("field", "harmed")
    (place / "harmed/photographs.json").write_text('{"format": 1}')
    before = content(place / "field")
    d = built / "d.png"
    for words, sentence in [
        ([d, "scene.ply"], "scene.ply: is a file, expected the folder of a field"),
        ([d, "nowhere"], "nowhere: no field.json there"),
        (["field"], "--add: found field and no photograph, expected some before the field"),
        ([d, "walls"], "walls: does not say which photographs it was built from"),
        ([d, "newer"], "format: found 9"),
        ([d, "harmed"], "harmed/photographs.json: damaged ("),
        ([built / "b.png", "field"], f"b.png: is in field already, as {built / 'b.png'}"),
        ([d, d, "field"], "twice"),
        (["stranger.png", "field"], "stranger.png: no camera for this photograph"),
        ([d, "field", "--cameras", "few.json"], "d.png: no camera for this photograph"),
        (["low.png", "field", "--cameras", "low.json"], "low.png: has another shape, and would"),
        ([d, "field", "--encoder", "clip"], "--encoder: with --add a field keeps the settings"),
        ([d, "field", "--clip-model", "x"], "--clip-model: with --add a field keeps"),
        ([d, "field", "--separated-error", "0.1"], "--separated-error: with --add a field keeps"),
        ([d, "field", "--refine"], "--refine: is for a new field"),
        ([d, "field", "--keyframes", "3"], "--keyframes: is for a new field"),
        ([d, "field", "-o", "walls/bank.npz"], "exists and is not a field"),
    ]:
        assert run(monkeypatch, "field", "--add", *words) == 2, words
        error = capsys.readouterr().err.splitlines()[-1]
        assert error.startswith("error: ") and sentence in error, error
    assert content(place / "field") == before


def test_photographs_that_moved_or_changed_are_told(built, tmp_path, monkeypatch, capsys):
    here = tmp_path / "here"
    shutil.copytree(built, here)
    listed = json.loads((here / "three/photographs.json").read_text())
    for own in listed["photographs"]:
        own[1] = own[1].replace(str(built), str(here))
    (here / "three/photographs.json").write_text(json.dumps(listed))
    before = content(here / "three")
    Image.open(here / "c.png").save(here / "b.png")
    assert run(monkeypatch, "field", "--add", here / "d.png", here / "three") == 2
    assert f"{here / 'b.png'}: was changed after {here / 'three'} was built" in said(capsys)
    (here / "b.png").unlink()
    assert run(monkeypatch, "field", "--add", here / "d.png", here / "three") == 2
    assert re.search(r"b.png: a photograph of .*three cannot be read \(No such file.*; put it back",
                     said(capsys))  # fmt: skip
    assert content(here / "three") == before


def test_work_that_fails_in_the_end_leaves_the_field(place, built, monkeypatch, capsys):
    def full(*args):
        raise OSError(28, "No space left on device")

    before = content(place / "field")
    monkeypatch.setattr("slgaussian.storage.store.os.rename", full)
    assert run(monkeypatch, "field", "--add", built / "d.png", "field") == 2
    assert "field: cannot be written (No space left on device)" in capsys.readouterr().err
    assert content(place / "field") == before
    assert [file.name for file in place.iterdir()] == ["field"]


def test_cameras_that_are_found_are_found_of_all(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene = datasets.load("procedural", seed=0, height=300, width=400)
    for name, file in zip(scene.cameras, NAMES[:3], strict=False):
        Image.fromarray(scene.read(name).image).save(file)
    solved = []
    inner = kept_pairs.find_pair
    monkeypatch.setattr(kept_pairs, "find_pair", lambda a, b: solved.append((a, b)) or inner(a, b))
    small = ["--size", "at most 96x128"]
    assert run(monkeypatch, "field", *NAMES[:2], *small, "-o", "field") == 0
    assert run(monkeypatch, "field", *NAMES[:3], *small, "-o", "three") == 0
    unposed._find.cache_clear()
    capsys.readouterr()
    solved.clear()
    assert run(monkeypatch, "field", "--add", NAMES[2], "field") == 0
    told = capsys.readouterr().err
    assert told.endswith(
        "1 added; reused 4 of 6 features, 1 of 2 leaves, 1 of 3 matches, 2 of 3 outlines, 2 of 3 "
        "palettes, 1 of 3 relative poses, 0 of 3 sweeps\n"
    )
    assert len(solved) == 2
    assert apart_from_ids(tmp_path / "field") == apart_from_ids(tmp_path / "three")


def test_a_pose_is_the_same_after_it_was_kept(monkeypatch):
    scene = datasets.load("procedural", seed=0, height=300, width=400)
    images = [scene.read(name).image for name in scene.cameras][:2]
    for other in (images[1], images[0][::-1]):  # a good pair, and one that tells nothing
        a, b = (
            Described.of(Photograph(name, np.ascontiguousarray(image), 1200, 900))
            for name, image in (("a", images[0]), ("b", other))
        )
        fresh = pair_pose(a, b)
        derived = Derived()
        with keeping(derived):
            pair_pose(a, b)
        with keeping(Derived(derived.kept)):
            monkeypatch.setattr(kept_pairs, "find_pair", lambda a, b: pytest.fail("solved again"))
            kept = pair_pose(a, b)
            monkeypatch.undo()
        assert repr(kept.found) == repr(fresh.found)  # of which numbers may be NaN
        assert (kept.advice, kept.probability) == (fresh.advice, fresh.probability)
        for name in kept_pairs.OF_POINTS:
            np.testing.assert_array_equal(getattr(kept, name), getattr(fresh, name))
        assert (kept.views is None) == (fresh.views is None)
        if fresh.views is not None:
            for name in (*kept_pairs.OF_VIEWS, "covariance"):
                np.testing.assert_array_equal(getattr(kept.views, name), getattr(fresh.views, name))
