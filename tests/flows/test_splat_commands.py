"""`slgaussian field` on a splat that exists: with photographs, with cameras, alone, and refused."""

import json
import shlex

import numpy as np
import pytest
from command import run, write_photographs

from benches.semantic.existing_splats import exact_splat
from slgaussian import datasets
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply, save_ply


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with a splat of a room, and its photographs with their cameras."""
    folder = tmp_path_factory.mktemp("place")
    room = datasets.load("procedural", seed=0, objects=4, views=3, height=144, width=192)
    names = ("view_00", "view_02")
    write_photographs(folder / "images", {f"{name}.png": room.read(name) for name in names})
    splat = exact_splat(room, list(room.cameras), 144, 192)
    save_ply(splat, folder / "room.ply")
    save_ply(splat[:0], folder / "empty.ply")
    other = datasets.load("procedural", seed=5, objects=4, views=3, height=144, width=192)
    write_photographs(folder / "other", {f"{name}.png": other.read(name) for name in names})
    (folder / "field").mkdir()
    (folder / "field" / "field.json").write_text("{}")
    return folder


@pytest.mark.parametrize(
    ("line", "origin", "used"),
    [
        ("--photographs images --cameras images", "photographs", 2),
        ("--cameras images", "renderings at the given cameras", 2),
        ("", "renderings along a path around the splat", None),
    ],
)
def test_field_of_a_splat_says_of_which_views_it_is(
    place, tmp_path, monkeypatch, capsys, line, origin, used
):
    monkeypatch.chdir(place)
    out = tmp_path / "out"
    assert run(monkeypatch, "field", "room.ply", *shlex.split(line), "-o", out) == 0
    told, field = capsys.readouterr(), SemanticField.load(out)
    assert told.out.strip() == str(out)
    assert f"views, {origin}: {', '.join(field.cameras)}\n" in told.err
    views = json.loads((out / "field.json").read_text())["settings"]["views"]
    assert views == {"kind": origin, "names": list(field.cameras)}
    assert used is None or len(field.cameras) == used
    kept, given = field.gaussians.to_arrays(), load_ply("room.ply")[0].to_arrays()
    assert all(np.array_equal(kept[name], given[name]) for name in ("means", "scales", "sh"))
    assert field.labels().any()


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("room.ply --photographs images", "cameras: found none for the photographs of a splat"),
        ("room.ply empty.ply", "found room.ply, empty.ply, expected one splat"),
        ("images --photographs images", "found images, expected one splat, .ply"),
        ("field --photographs images", "field: is a field, which answers words already"),
        ("empty.ply --cameras images", "empty.ply: none of its 0 Gaussians is visible"),
        ("none.ply --cameras images", "gaussians splat: there is no 'none.ply'"),
        ("room.ply --cameras images --predictor mvsplat", "found 'mvsplat' and the splat room.ply"),
        ("room.ply --photographs other --cameras other", "two worlds: it has"),
    ],
)
def test_field_refuses_splats_in_one_sentence(place, monkeypatch, capsys, line, sentence):
    monkeypatch.chdir(place)
    assert run(monkeypatch, "field", *shlex.split(line), "-o", "out") == 2
    error = capsys.readouterr().err.splitlines()[-1]  # lines on progress may come first
    assert error.startswith("error: ") and sentence in error
    assert not (place / "out").exists()
