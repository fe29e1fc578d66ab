"""`slgaussian masks`, and a field built from what it wrote."""

import json

import numpy as np
import pytest
from command import ROOM, room_sample, run, said, save_photographs
from PIL import Image

import slgaussian as slg
from flows.cli.app import app
from slgaussian.geometry import SeenView
from slgaussian.masks.precomputed import Precomputed, encode_ids, read_ids

PHOTOS = [f"{name}.png" for name in ROOM["context"]]


@pytest.fixture
def words(tmp_path, monkeypatch):
    """A command about two photographs, up to where it writes to."""
    monkeypatch.chdir(save_photographs(tmp_path))
    return [*PHOTOS, "--cameras", "transforms.json", "--set", "near=0.8", "--set", "far=12"]


def test_masks_that_are_written_are_those_that_a_field_reads(words, tmp_path, monkeypatch, capsys):
    assert run(monkeypatch, "masks", *words, "-o", "ids") == 0
    printed = capsys.readouterr().out
    files = sorted(file.name for file in (tmp_path / "ids").iterdir())
    assert files == ["look.jpg", "masks.json", *PHOTOS]
    maps = np.stack([read_ids(tmp_path / "ids" / name) for name in PHOTOS])
    assert maps.shape == (2, 64, 64) and maps.max() > 2
    assert Image.open(tmp_path / "ids" / PHOTOS[0]).mode.startswith("I;16")
    objects = np.setdiff1d(maps, [0])
    shared = np.intersect1d(*(np.setdiff1d(first, [0]) for first in maps))
    assert f"{len(objects)} objects, {len(shared)} of them in several views" in printed
    assert len(shared)

    # They are what a field is built from without them, and the same ids come back.
    sample = room_sample()
    rerun = Precomputed(folder=tmp_path / "ids")
    for view, ids in zip(sample.context, maps, strict=True):
        np.testing.assert_array_equal(rerun.propagate(SeenView(view)), ids)
    tracker = ["--tracker", "precomputed", "--set", "precomputed.folder=ids"]
    assert run(monkeypatch, "field", *words, *tracker, "-o", "given") == 0
    inputs = slg.SemanticField.load("given")
    assert inputs.bank.ids.tolist() == objects.tolist()
    present = np.stack([[(first == i).any() for first in maps] for i in objects])
    np.testing.assert_array_equal(inputs.bank.present, present)

    info = json.loads((tmp_path / "ids" / "masks.json").read_text())
    assert info["views"] == {name: name for name in PHOTOS}
    assert info["settings"]["proposer"] == {"regions": {}}
    assert info["settings"]["votes"] == "views"


def test_masks_replace_masks_and_nothing_else(words, tmp_path, monkeypatch, capsys):
    second = tmp_path / "kept"
    second.mkdir()
    (second / "letter.txt").write_text("dear")
    assert run(monkeypatch, "masks", *words, "-o", "kept") == 2
    assert "exists and is not a folder of masks" in said(capsys)
    assert run(monkeypatch, "masks", *words, "--tracker", "swiss", "-o", "ids") == 2
    assert "swiss" in said(capsys)
    assert not (tmp_path / "ids").exists()
    for _ in range(2):
        assert run(monkeypatch, "masks", *words, "-o", "ids") == 0
    # What fails half way leaves what was there.
    before = {file.name: file.read_bytes() for file in (tmp_path / "ids").iterdir()}
    with monkeypatch.context() as patched:
        patched.setattr("slgaussian.benchmark.pictures.encode_jpeg", lambda *a: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            app(["masks", *words, "-o", "ids"], standalone_mode=False)
    after = {file.name: file.read_bytes() for file in (tmp_path / "ids").iterdir()}
    assert after == before
    assert sorted(f.name for f in tmp_path.iterdir()) == ["ids", "kept", "transforms.json", *PHOTOS]


@pytest.mark.parametrize(("top", "suffix"), [(0, ".png"), (65535, ".png"), (65536, ".npy")])
def test_a_map_of_any_ids_reads_as_it_was_written(tmp_path, top, suffix):
    ids = np.array([[0, 1, 300], [top, 2, 0]], np.int32).clip(0, max(top, 0))
    result, data = encode_ids(ids)
    assert result == suffix
    (tmp_path / f"a{result}").write_bytes(data)
    np.testing.assert_array_equal(read_ids(tmp_path / f"a{result}"), ids)
