"""Depth from files: exported depth, every file format, and conventions that must fit."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from textured_planes import Plane, camera, sample

from slgaussian.build import predict
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import read_map, write_map
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.masks.configs import geometry_digest
from slgaussian.predict import load_predictor
from slgaussian.predict.planesweep import PlaneSweep, sweep
from slgaussian.predict.precomputed import _read as read_depths
from slgaussian.predict.precomputed import find_maps
from slgaussian.predict.view_graph import link_views
from slgaussian.scene import Sample, View
from tests.program_outputs import write_da3_cli, write_pfm

STEEP = Plane(np.array([0.5, 0.4, 1.0]), 3.0)
CAMERAS = camera(turn=0.1), camera(x=0.6, turn=-0.1)


@pytest.fixture(scope="module")
def steep() -> Sample:
    views = [STEEP.view(f"images/{i}.png", first) for i, first in enumerate(CAMERAS)]
    return Sample("steep", tuple(views))


def true_depth(scene: Sample) -> np.ndarray:
    return np.array([view.depth for view in scene.context])


def save(folder: Path, **arrays: np.ndarray) -> Path:
    np.savez(folder / "results.npz", **arrays)
    return folder / "results.npz"


def predict_from(scene: Sample, place: Path) -> Gaussians:
    gaussians = load_predictor("precomputed", geometry=place)(scene)
    gaussians.check()
    return gaussians


def predict_depths(scene: Sample, place: Path) -> np.ndarray:
    return source_depths(predict_from(scene, place), [view.camera for view in scene.context])


def off(scene: Sample, place: Path) -> float:
    """Median relative error of depth."""
    return float(np.median(np.abs(predict_depths(scene, place) / true_depth(scene) - 1)))


@pytest.mark.parametrize("count", [2, 3])
def test_depth_of_a_sweep_read_again_makes_the_gaussians_of_the_sweep(tmp_path, count):
    cameras = [camera(x=0.2 * i, turn=0.05 * i) for i in range(count)]
    scene = sample(*cameras)
    swept = sweep(PlaneSweep(), scene, link_views(scene, False).links)
    depth = [np.where(s.answered, 1 / s.inverse_depth.astype(float), 0) for s in swept]
    expected = PlaneSweep()(scene).to_arrays()
    arrays = predict_from(scene, save(tmp_path, depth=np.array(depth))).to_arrays()
    for name, values in expected.items():
        np.testing.assert_allclose(arrays[name], values, atol=1e-6, err_msg=name)


KINDS = {
    "png": write_map,
    "tiff": lambda file, depth: Image.fromarray(depth).save(file),
    "npy": write_map,
    "pfm": write_pfm,
}


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_a_map_are_read(tmp_path, kind):
    depth = np.linspace(0.5, 7.0, 12, dtype=np.float32).reshape(3, 4)
    KINDS[kind](tmp_path / f"d.{kind}", depth)
    np.testing.assert_allclose(read_map(tmp_path / f"d.{kind}"), depth, atol=1e-3)


@pytest.mark.parametrize(
    ("largest", "unit"), [(7, 1e-3), (65.5, 1e-3), (70, 1e-2), (41000, 1), (3e-2, 1e-6)]
)
def test_a_png_holds_depth_of_any_range_in_the_unit_that_it_states(tmp_path, largest, unit):
    depth = np.linspace(0.3, 1, 12, dtype=np.float32).reshape(3, 4) * largest
    assert write_map(tmp_path / "d.png", depth) == pytest.approx(unit)
    with Image.open(tmp_path / "d.png") as image:
        pixels, is_usual = np.asarray(image), "slgaussian depth unit" not in image.info
    assert is_usual == (unit == 1e-3)
    np.testing.assert_allclose(pixels * unit, depth, atol=unit / 2 * 1.01)
    np.testing.assert_allclose(read_map(tmp_path / "d.png"), pixels * unit)
    np.testing.assert_allclose(read_map(tmp_path / "d.png", unit=2, stated=False), pixels * 2)


def test_a_map_of_another_format_is_said_with_those_that_depth_may_have(tmp_path, steep):
    np.savez(tmp_path / "d.npz", depth=np.full((3, 4), 2.5))
    assert (read_map(tmp_path / "d.npz") == 2.5).all()
    np.savez(tmp_path / "two.npz", depth=np.full((2, 3, 4), 2.5))
    with pytest.raises(InputError, match=r"two\.npz: holds 2 depth maps, expected that of one"):
        read_map(tmp_path / "two.npz")
    (tmp_path / "0.exr").write_bytes(b"v/1\1")
    with pytest.raises(
        InputError, match=r"0\.exr: cannot be read \(EXR\); save depth as \.npy"
    ) as e:
        predict_from(steep, tmp_path)
    assert "photograph" not in str(e.value)


def test_samples_of_one_place_share_its_folder(tmp_path, steep):
    for place, scale in (("hall", 1), ("hall_old", 3)):
        (tmp_path / place).mkdir()
        for number, depth in enumerate(true_depth(steep)):
            np.save(tmp_path / place / f"{number}.npy", depth * scale)
    views = [replace(view, name=str(i)) for i, view in enumerate(steep.context)]
    for scene, scale in (("hall", 1), ("hall_0000_0001", 1), ("hall_old_0000_0001", 3)):
        maps = find_maps(tmp_path, Sample(scene, tuple(views)))
        assert np.allclose([m.depth for m in maps], true_depth(steep) * scale)
    with pytest.raises(InputError, match=r"has no depth of view '0'"):
        find_maps(tmp_path, Sample("hallway", tuple(views)))


def test_a_folder_of_millimetres_at_half_the_size_is_read_below_the_scene(tmp_path, steep):
    folder = tmp_path / "steep" / "images"
    folder.mkdir(parents=True)
    for view in steep.context:
        half = cv2.resize(view.depth, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_NEAREST)
        KINDS["png"](folder / Path(view.name).name, half)
    assert off(steep, tmp_path) < 0.01


def along_rays(view: View) -> np.ndarray:
    return view.depth * np.linalg.norm(view.camera.rays(), axis=-1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda view, i: along_rays(view), "along the ray"),
        (lambda view, i: 1000 * view.depth, "times 0.001"),
        (lambda view, i: (2 + i) * view.depth, "by view"),
        (lambda view, i: view.depth[15:105], "of cropped photographs"),
        (lambda view, i: np.pad(view.depth, ((20, 20), (0, 0))), "of padded photographs"),
    ],
    ids=["ray", "millimetres", "scales", "cropped", "padded"],
)
def test_the_reading_that_fits_is_taken_and_said(tmp_path, steep, change, message):
    depth = np.array([change(view, i) for i, view in enumerate(steep.context)])
    with pytest.warns(UserWarning, match=message):
        assert off(steep, save(tmp_path, depth=depth)) < 0.01


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda depth: depth[:, ::-1], "does not fit the photographs"),
        (lambda depth: 1 / depth, "does not fit the photographs"),
        (lambda depth: depth[:, :, ::-1], "does not fit the photographs"),
        (lambda depth: depth[:1], "1 maps without names, for 2 photographs"),
        (lambda depth: np.zeros_like(depth), "hold no depth"),
    ],
)
def test_depth_that_no_reading_fits_is_refused(tmp_path, steep, change, message):
    file = save(tmp_path, depth=change(true_depth(steep)))
    with pytest.raises(InputError, match=message):
        predict_from(steep, file)


@pytest.mark.parametrize("step", [0.6, 0.1, 0.03])
def test_disparity_given_as_depth_is_refused_at_any_parallax(tmp_path, step):
    pair = camera(turn=0.02), camera(x=step, turn=-0.02)
    scene = Sample("steep", tuple(STEEP.view(f"{i}.png", one) for i, one in enumerate(pair)))
    depth = true_depth(scene)
    assert off(scene, save(tmp_path, depth=depth)) < 0.02
    for disparity in (1 / depth, 80 / depth, 1 / depth + 0.01):
        with pytest.raises(InputError, match=r"1 / map takes \d+%, so it is disparity or inverse"):
            predict_from(scene, save(tmp_path, depth=disparity))


@pytest.mark.parametrize("change", [np.ones_like, lambda depth: depth[:, ::-1]])
def test_depth_that_the_matches_cannot_confirm_is_said(tmp_path, change):
    flat = Plane(np.array([0.03, 0.02, 1.0]), 3.0)
    pair = camera(), camera(x=0.1)
    scene = Sample("flat", tuple(flat.view(f"{i}.png", one) for i, one in enumerate(pair)))
    says = (
        r"cannot confirm the depth: it takes (9\d|100)% of .* one depth for all pixels (9\d|100)%"
    )
    with pytest.warns(UserWarning, match=says):
        predict_from(scene, save(tmp_path, depth=change(true_depth(scene))))


def test_a_reading_that_no_match_checks_is_said(tmp_path, steep):
    blank = [replace(view, image=np.full_like(view.image, 90)) for view in steep.context]
    maps = find_maps(save(tmp_path, depth=true_depth(steep)), steep)
    with pytest.warns(UserWarning, match="too few matches, 0, to check how its numbers are meant"):
        read_depths(tmp_path, blank, maps, {})


def test_names_tell_maps_apart(tmp_path, steep):
    depth = true_depth(steep)[::-1]
    file = save(tmp_path, depth=depth, names=["1.jpg", "0.jpg"])
    assert off(steep, file) < 0.005
    with pytest.raises(InputError, match=r"no map of view 'images/1\.png'; its names begin with 0"):
        predict_from(steep, save(tmp_path, depth=depth, names=["0.jpg", "5.jpg"]))


def test_pixels_without_depth_are_completed(tmp_path, steep):
    depth = true_depth(steep)
    depth[:, 40:60, 50:90] = np.nan
    assert off(steep, save(tmp_path, depth=depth)) < 0.005
    arrays = predict_from(steep, save(tmp_path, depth=depth)).to_arrays()
    hole = np.abs(predict_depths(steep, tmp_path / "results.npz") / true_depth(steep) - 1)[
        :, 45:55, 55:85
    ]
    assert hole.max() < 0.02
    assert np.isfinite(arrays["means"]).all()


@pytest.mark.parametrize("sure", [(0.0, 2.0), (1.02, 34.0)], ids=["phone", "unbounded"])
def test_depth_of_low_confidence_is_a_guess(tmp_path, steep, sure):
    depth = true_depth(steep)
    noise = np.random.default_rng(0).uniform(0.6, 1.6, depth[:, :40].shape)
    depth[:, :40] *= noise
    confidence = np.full(depth.shape, sure[1])
    confidence[:, :40] = sure[0]
    confidence += 1e-3 * np.random.default_rng(1).random(depth.shape)
    place = save(tmp_path, depth=depth, conf=confidence)
    gaussians = predict(steep, load_predictor("precomputed", geometry=place), 0).gaussians
    arrays = gaussians.to_arrays()
    row = arrays["source"] // steep.context[0].camera.width % steep.context[0].camera.height
    visible = ~arrays["guessed"]
    assert visible[row < 40].mean() < 0.1  # what shares a step of confidence with what is sure
    assert visible[row >= 50].mean() > 0.7


def test_identity_of_numbered_views_has_their_cameras(tmp_path, steep):
    folder = write_da3_cli(tmp_path / "depth", steep.context)
    before = geometry_digest(folder)
    (folder / "out_view1.json").write_text("{}")
    assert geometry_digest(folder) != before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: (d / "out_view0.json").unlink(), "out_view1.pfm, expected the views of one"),
        (lambda d: shutil.copy(d / "out_view0.pfm", d / "out_view2.pfm"), None),
        (lambda d: (d / "out_view1.json").write_text('{"extrinsics": [[1]]}'), "view1.json: holds"),
        (lambda d: (d / "out_view1.json").write_text("{"), "out_view1.json: holds no extrinsics"),
        (lambda d: write_pfm(d / "out_view1.pfm", np.ones((3, 4))), r"is \(3, 4\), expected"),
        (
            lambda d: (d / "out_view1.pfm").write_bytes(b"Pf\n9 9\n-1\n"),
            "view1.pfm: cannot be read",
        ),
        (
            lambda d: [f.rename(d / f.name.replace("out", "p")) for f in [*d.glob("*1.*")]],
            "holds out_view0.pfm, p_view1.pfm, expected the views of one call",
        ),
    ],
    ids=["no json", "no json of a third", "shape", "no json text", "size", "cut", "two calls"],
)
def test_numbered_views_that_are_not_whole_are_refused(tmp_path, steep, change, message):
    folder = write_da3_cli(tmp_path / "depth", steep.context)
    change(folder)
    if message is None:  # it is no view of this program
        assert off(steep, folder) < 0.01
        return
    with pytest.raises(InputError, match=message):
        predict_from(steep, folder)
    three = Sample("steep", (*steep.context, replace(steep.context[0], name="c.png")))
    with pytest.raises(InputError, match=r"holds 2 maps without names, for 3 .*; give the photog"):
        predict_from(three, write_da3_cli(tmp_path / "two", steep.context))


def test_what_cannot_be_read_is_said(tmp_path, steep):
    for place, says in ({}, "none given"), ({"geometry": tmp_path / "no.npz"}, "there is no"):
        with pytest.raises(InputError, match=f"precomputed geometry: {says}"):
            load_predictor("precomputed", **place)
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="cannot be read"):
        predict_from(steep, tmp_path / "bad.npz")
    with pytest.raises(InputError, match="holds no depth; expected one of depth"):
        predict_from(steep, save(tmp_path, disparity=true_depth(steep)))
    with pytest.raises(InputError, match=r"has no depth of view 'images/0\.png'"):
        predict_from(steep, tmp_path)
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "0.png")
    with pytest.raises(InputError, match="expected one number a pixel, of 16 bits"):
        predict_from(steep, tmp_path)
    (tmp_path / "0.tiff").write_bytes(b"")
    with pytest.raises(InputError, match=r"0\.\w+: 0\.\w+ is there too, .*; remove one of them"):
        predict_from(steep, tmp_path)


def test_views_that_were_cropped_from_their_photographs_get_their_part(tmp_path, steep):
    smaller = replace(steep, context=tuple(view.resize(100, 160) for view in steep.context))
    assert off(smaller, save(tmp_path, depth=true_depth(steep))) < 0.005
