"""Found cameras in the files of other programs, read by pycolmap and by the readers here."""

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image
from taken_photographs import stereo_pair, write_photograph

from slgaussian.cameras.estimated import EstimatedCameras
from slgaussian.datasets import llff, unposed
from slgaussian.datasets.camera_files import check_target, write_cameras
from slgaussian.datasets.recognise import posed_scene
from slgaussian.datasets.sparse_model import build_sparse_model
from slgaussian.errors import InputError


class Found(NamedTuple):
    """Photographs as they are stored, and what was found for them."""

    files: dict[str, Path]
    estimated: EstimatedCameras


@pytest.fixture(scope="module")
def upright(tmp_path_factory):
    folder = tmp_path_factory.mktemp("upright")
    for name, pixels in zip(("b.png", "a.png"), stereo_pair(), strict=True):
        write_photograph(folder / name, pixels)
    files = unposed.name_files([folder])
    return Found(files, unposed.find(files))


@pytest.fixture(
    params=[(None, 0.0), (6, 0.0), (8, -0.2), (3, -0.05)],
    ids=["upright", "right", "left, distorted", "upside down, distorted"],
)
def solution(request, upright, tmp_path):
    """The pair, stored with an EXIF orientation, and as if a lens of that k1 had been found."""
    orientation, k1 = request.param
    folder = tmp_path / "photos"
    folder.mkdir()
    for name, file in upright.files.items():
        with Image.open(file) as image:
            write_photograph(folder / name, np.asarray(image), orientation)
    distortions = {"a.png": k1} if k1 else {}
    files = {name: folder / name for name in upright.files}
    return Found(files, replace(upright.estimated, distortions=distortions))


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
def test_colmap_model_projects_in_pycolmap_as_here(solution, format, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    write_cameras(tmp_path / "sparse/0", format, *solution)
    expected = build_sparse_model(*solution)
    model = pycolmap.Reconstruction(tmp_path / "sparse/0")
    assert [model.images[i].name for i in (1, 2)] == list(solution.files)
    for image in model.images.values():
        camera, k1 = expected.cameras[image.name], solution.estimated.distortions.get(image.name, 0)
        assert image.cam_from_world().matrix() == pytest.approx(camera.w2c[:3], abs=1e-14)
        assert (image.camera.calibration_matrix() == camera.K).all()
        assert image.camera.params.tolist()[3:] == ([k1] if k1 else [camera.K[1, 2]])
        with Image.open(solution.files[image.name]) as stored:
            assert (image.camera.width, image.camera.height) == stored.size
    assert len(model.points3D) == len(expected.points) > 500
    values = [(p.xyz, p.color, p.error) for _, p in sorted(model.points3D.items())]
    xyz, colours, errors = map(np.array, zip(*values, strict=True))
    assert (xyz == expected.points).all() and (colours == expected.colours).all()
    model.update_point_3d_errors()
    theirs = [point.error for _, point in sorted(model.points3D.items())]
    assert errors == pytest.approx(np.array(theirs), abs=1e-6) and errors.mean() < 0.5
    # A point has the colours that the stored photographs show where it is seen.
    for _, point in sorted(model.points3D.items())[::50]:
        shown = []
        for seen in point.track.elements:
            image = model.images[seen.image_id]
            column, row = map(int, image.points2D[seen.point2D_idx].xy)
            shown.append(np.asarray(Image.open(solution.files[image.name]))[row, column])
        assert point.color == pytest.approx(np.mean(shown, 0), abs=1)


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
def test_colmap_model_is_read_as_the_found_cameras(solution, format, tmp_path):
    write_cameras(tmp_path / "model", format, *solution)
    scene, _ = posed_scene(tmp_path / "model", [str(file) for file in solution.files.values()])
    assert scene.estimation == json.loads(json.dumps(solution.estimated.as_json()))
    for name, camera in build_sparse_model(*solution).cameras.items():
        mine = scene.cameras[name]
        np.testing.assert_allclose(mine.c2w, camera.c2w, atol=1e-12)
        assert (mine.K == camera.K).all() and mine.estimated == camera.estimated is not None
        if name not in solution.estimated.distortions:
            with Image.open(solution.files[name]) as stored:
                assert (scene.read(name).image == np.asarray(stored)).all()


def test_colmap_model_that_was_changed_is_given_and_kept(upright, tmp_path):
    place = tmp_path / "model"
    place.mkdir()
    assert check_target(place) == "colmap"  # as it is empty
    write_cameras(place, "colmap-text", *upright)
    assert check_target(place) == "colmap"
    (place / "points3D.ply").write_bytes(b"ply")  # as programs that train leave it
    files = [str(file) for file in upright.files.values()]
    assert posed_scene(place, files)[0].estimation
    with pytest.raises(InputError, match="model: exists and is no COLMAP model as"):
        check_target(place)
    (place / "points3D.ply").unlink()
    with (place / "images.txt").open("a") as file:
        file.write("# refined\n")
    scene, _ = posed_scene(place, files)
    assert not scene.estimation and scene.cameras["a.png"].estimated is None
    with pytest.raises(InputError, match="model: exists and is no COLMAP model as"):
        check_target(place)


def test_poses_bounds_are_read_as_the_stored_cameras(solution, tmp_path):
    out = solution.files["a.png"].parent / "poses_bounds.npy"
    if solution.estimated.distortions:
        with pytest.raises(InputError, match=r"cannot hold the distortion of 'a\.png'; write"):
            write_cameras(out, "llff", *solution)
        return
    write_cameras(out, "llff", *solution)
    scene, expected = llff.read(out.parent, "."), build_sparse_model(*solution)
    for view, (name, camera) in enumerate(expected.cameras.items()):
        mine = scene.cameras[name]
        np.testing.assert_allclose(mine.c2w, camera.c2w, atol=1e-12)
        np.testing.assert_allclose(mine.K, camera.K, atol=1e-12)
        seen = expected.tracks.track[expected.tracks.view == view]
        depth = expected.points[seen] @ camera.w2c[2, :3] + camera.w2c[2, 3]
        assert ((depth > mine.near) & (depth < mine.far)).mean() > 0.99
    Image.new("RGB", (8, 8)).save(out.parent / "c.png")
    with pytest.raises(InputError, match=r"without names, but of .*'c\.png' has no camera; write"):
        write_cameras(out, "llff", *solution)


@pytest.mark.parametrize(
    ("name", "format", "refusal"),
    [
        ("a.json", "colmap", r"a\.json: found \.json, expected no suffix, as of colmap"),
        ("a", "llff", r"a: found no suffix, expected \.npy, as of llff"),
        ("a.txt", None, r"a\.txt: found \.txt, expected no suffix, as a folder of COLMAP's"),
        ("a", "bundler", "format: found 'bundler', expected one of colmap, colmap-text, nerf"),
        ("full", None, "full: exists and is no COLMAP model as `slgaussian cameras` wrote it"),
        ("full/x", None, "x: exists and is no COLMAP model as"),
        ("full/p.npy", None, "p.npy: exists and was not written by `slgaussian cameras`"),
        ("full/j.json", None, r"j\.json: cannot be written \(Is a directory\)"),
    ],
)
def test_target_of_cameras_is_refused(tmp_path, name, format, refusal):
    (tmp_path / "full/j.json").mkdir(parents=True)
    for other in ("x", "p.npy"):
        (tmp_path / "full" / other).write_text("mine")
    with pytest.raises(InputError, match=refusal):
        check_target(tmp_path / name, format)


@pytest.mark.parametrize(
    ("orientation", "new_name", "refusal"),
    [
        (5, "a.png", r"a\.png: is stored as a mirror image \(EXIF orientation 5\)"),
        (1, "a b.png", r"'a b\.png': has a space, which ends a name in COLMAP's text files"),
    ],
)
def test_model_that_cannot_be_written_leaves_the_old_one(
    upright, tmp_path, orientation, new_name, refusal
):
    write_cameras(tmp_path / "model", "colmap-text", *upright)
    before = {file.name: file.read_bytes() for file in (tmp_path / "model").iterdir()}
    a, rest = upright.files["a.png"], upright.estimated
    with Image.open(a) as image:
        file = write_photograph(tmp_path / "a.png", np.asarray(image), orientation)
    cameras = {new_name if n == "a.png" else n: c for n, c in rest.cameras.items()}
    files = {**upright.files, new_name: file}
    with pytest.raises(InputError, match=refusal):
        write_cameras(tmp_path / "model", "colmap-text", files, replace(rest, cameras=cameras))
    assert {file.name: file.read_bytes() for file in (tmp_path / "model").iterdir()} == before


def test_bundle_adjustment_of_pycolmap_hardly_moves_found_cameras(real_data, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    files = unposed.name_files([real_data / "strangers/boxes"])
    write_cameras(tmp_path / "model", "colmap", files, unposed.find(files))
    model = pycolmap.Reconstruction(tmp_path / "model")
    before = model.images[2].cam_from_world().rotation.matrix()
    options = pycolmap.BundleAdjustmentOptions(refine_focal_length=False, print_summary=False)
    pycolmap.bundle_adjustment(model, options)
    first, second = (model.images[i].cam_from_world().rotation.matrix() for i in (1, 2))
    cosine = (np.trace(before.T @ second @ first.T) - 1) / 2
    assert 0 < np.degrees(np.arccos(min(cosine, 1))) < 0.3
