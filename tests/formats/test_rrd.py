"""Recordings, read by Rerun's own reader and drawn by its viewer."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from slgaussian.formats.rrd import save_rrd
from slgaussian.formats.splats import save_gaussians
from slgaussian.gaussians import SH_C0, Gaussians
from tests.formats.test_compact import make_gaussians
from tests.formats.test_usd import FAR, LABELS, make_cameras

rr = pytest.importorskip("rerun", reason="needs the extra rerun: pip install rerun-sdk")


def run(home, *words) -> subprocess.CompletedProcess:
    """Run Rerun's program as in a first session, which sends nothing to its makers."""
    command = [sys.executable, "-m", "rerun", *map(str, words)]
    env = os.environ | {"HOME": str(home), "XDG_RUNTIME_DIR": str(home)}
    return subprocess.run(command, capture_output=True, text=True, timeout=120, env=env)


def read(path) -> dict[str, list]:
    """Return the components of all entities of a recording."""
    from rerun.chunk import RrdReader

    return {
        f"{chunk.entity_path} {name}": values[0]
        for chunk in RrdReader(path).stream()
        for name, values in chunk.to_record_batch().to_pydict().items()
    }


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_save_rrd_writes_numbers_that_reruns_reader_reads_back(tmp_path, degree):
    gaussians = replace(make_gaussians(degree=degree), origin=FAR)
    save_rrd(gaussians, tmp_path / "a.rrd", LABELS, make_cameras())
    found = read(tmp_path / "a.rrd")
    assert found["/world origin"] == FAR.tolist()
    assert found["/world/gaussians label"] == LABELS.tolist()
    splats = {
        name: np.array(found[f"/world/gaussians GaussianSplats3D:{name}"])
        for name in ("centers", "scales", "quaternions", "colors")
    }
    arrays = gaussians.to_arrays()
    np.testing.assert_array_equal(splats["centers"].astype("f4"), arrays["means"])
    np.testing.assert_array_equal(splats["scales"].astype("f4"), arrays["scales"])
    quats = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    np.testing.assert_allclose(splats["quaternions"][:, [3, 0, 1, 2]], quats, atol=1e-6)
    rgba = splats["colors"].astype(">u4").view(np.uint8).reshape(-1, 4) / 255
    dc = (arrays["sh"][:, 0] * SH_C0 + 0.5).clip(0, 1)
    np.testing.assert_allclose(rgba, np.column_stack([dc, arrays["opacities"]]), atol=0.501 / 255)
    name = "/world/gaussians GaussianSplats3D:sh_coefficients"
    if degree:
        higher = np.array(found[name])
        rest = arrays["sh"].shape[1] - 1
        np.testing.assert_allclose(higher[:, :rest], arrays["sh"][:, 1:], atol=5e-4)
        assert not higher[:, rest:].any()
    else:
        assert name not in found
    camera = gaussians.localize(make_cameras()["a b.jpg"])
    view = {key.partition(" b.jpg ")[2]: value for key, value in found.items() if "/views/" in key}
    np.testing.assert_allclose(view["Pinhole:image_from_camera"][0], camera.K.T.ravel())
    assert view["Pinhole:resolution"][0] == [64, 48]
    np.testing.assert_allclose(view["Transform3D:translation"][0], camera.center, atol=1e-6)
    rotation = np.reshape(view["Transform3D:mat3x3"][0], (3, 3)).T
    np.testing.assert_allclose(rotation, camera.c2w[:3, :3], atol=1e-6)


def test_save_rrd_writes_the_same_content_at_any_time(tmp_path):
    """Bytes differ: Rerun numbers chunks by the time, and writes metadata in any order."""
    from rerun.chunk import RrdReader

    for name in "ab":
        save_gaussians(make_gaussians(), tmp_path / f"{name}.rrd", LABELS, make_cameras())
    assert run(tmp_path, "rrd", "verify", tmp_path / "a.rrd").returncode == 0
    same = run(tmp_path, "rrd", "compare", "--unordered", tmp_path / "a.rrd", tmp_path / "b.rrd")
    assert same.returncode == 0, same.stderr
    save_gaussians(make_gaussians(seed=1), tmp_path / "c.rrd")
    ids = [RrdReader(tmp_path / f"{name}.rrd").recordings()[0].recording_id for name in "abc"]
    assert ids[0] == ids[1] != ids[2]  # those of one id are drawn as one scene


def test_save_rrd_is_drawn_by_reruns_viewer_where_it_is(tmp_path):
    """A red Gaussian to the left and a green one above, seen from the first camera."""
    import rerun.blueprint as rrb

    gaussians = Gaussians(
        means=torch.tensor([[-0.5, 0, 3], [0, -0.5, 3]]),
        scales=torch.full((2, 3), 0.1),
        quats=torch.tensor([[1.0, 0, 0, 0]] * 2),
        opacities=torch.ones(2),
        sh=(torch.tensor([[[1.0, 0, 0]], [[0, 1.0, 0]]]) - 0.5) / SH_C0,
        source=torch.arange(2).int(),
    )
    save_gaussians(gaussians, tmp_path / "a.rrd")
    eye = rrb.EyeControls3D(position=(0, 0, 0), look_target=(0, 0, 3), eye_up=(0, -1, 0))
    grid = rrb.LineGrid3D(visible=False)
    view = rrb.Spatial3DView(
        contents="world/gaussians", background=[0, 0, 0], line_grid=grid, eye_controls=eye
    )
    look = rrb.Blueprint(view, collapse_panels=True, auto_views=False, auto_layout=False)
    look.save("slgaussian", tmp_path / "a.rbl")
    drawn = run(
        tmp_path,
        *(tmp_path / "a.rrd", tmp_path / "a.rbl", "--headless", "--port", "0"),
        *("--window-size", "1200x900", "--screenshot-to", tmp_path / "a.png"),
    )
    if not (tmp_path / "a.png").exists():
        pytest.skip(f"no Vulkan driver, such as mesa-vulkan-drivers: {drawn.stderr[-300:]}")
    image = np.array(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)[100:-100]
    middle = {}
    for channel in (0, 1):
        others = np.delete(image, channel, 2).max(2)
        middle[channel] = np.mean(np.nonzero((image[..., channel] > 200) & (others < 40)), 1)
    (red_y, red_x), (green_y, green_x) = middle[0], middle[1]
    assert red_x < green_x and green_y < red_y
