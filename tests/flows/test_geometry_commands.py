"""Depth and cameras of a file, by command and by flow."""

import numpy as np
import pytest
from command import room, run, score
from PIL import Image

from flows.read_config import read_toml
from slgaussian.field import SemanticField
from slgaussian.masks.configs import geometry_digest
from slgaussian.storage.store import ArtifactStore

SIZE = 192, 256
VIEWS = "view_00", "view_02"


@pytest.fixture
def results(tmp_path):
    """An NPZ in the layout of Depth Anything 3, with its photographs beside it."""
    views = [room(*SIZE).read(name) for name in VIEWS]
    for view in views:
        Image.fromarray(view.image).save(tmp_path / f"{view.name}.png")
    np.savez(
        tmp_path / "results.npz",
        depth=np.array([view.depth for view in views]),
        conf=np.ones((2, *SIZE), np.float32),
        extrinsics=np.array([view.camera.w2c[:3] for view in views]),
        intrinsics=np.array([view.camera.K for view in views]),
    )
    return tmp_path / "results.npz"


def test_a_field_is_built_of_depth_and_cameras_of_a_file(tmp_path, monkeypatch, results):
    photos = [tmp_path / f"{name}.png" for name in VIEWS]
    words = ["--predictor", "precomputed", "--set", f"precomputed.geometry={results}"]
    assert run(monkeypatch, "field", *photos, *words, "-o", tmp_path / "field") == 0
    field = SemanticField.load(tmp_path / "field")
    assert field.settings["predictor"] == "precomputed"
    assert field.settings["precomputed"]["geometry"] == geometry_digest(results)
    assert field.settings["quality"]["confirmed"] > 0.8
    for name in VIEWS:
        expected = room(*SIZE).cameras[name]
        np.testing.assert_allclose(field.cameras[f"{name}.png"].c2w, expected.c2w, atol=1e-6)
        observed = field.render(field.cameras[f"{name}.png"])
        truth = room(*SIZE).read(name).depth
        assert np.median(np.abs(observed.depth / truth - 1)) < 0.02


@pytest.mark.usefixtures("server")
def test_a_run_reads_depth_and_cameras_of_one_file(tmp_path, results):
    (tmp_path / "run.toml").write_text(
        'predictor = "precomputed"\n[precomputed]\ngeometry = "results.npz"\n'
        '[[scenes]]\nname = "room"\nformat = "npz"\npath = "results.npz"\n'
        f"context = {list(VIEWS)}\nqueries = ['wall']\n"
    )
    settings = read_toml(tmp_path / "run.toml", {"out": str(tmp_path / "out")})
    store = ArtifactStore(str(tmp_path / "store"))
    assert not score(settings, store).failures
    assert SemanticField.load(tmp_path / "out" / "fields" / "room").settings["predictor"] == (
        "precomputed"
    )
