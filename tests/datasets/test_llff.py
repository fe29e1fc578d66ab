"""LLFF scenes: order and size of photographs, damaged files, and a real scene's geometry."""

import pickle

import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, WIDTH, llff_row

from slgaussian.cameras.relative import Relative
from slgaussian.datasets import llff, load
from slgaussian.errors import InputError
from tests.matching import sift_matches


def write(root, rows, names, folder="images", size=(WIDTH, HEIGHT)):
    (root / folder).mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        Image.new("RGB", size, (i + 1, 0, 0)).save(root / folder / name)
    np.save(root / "poses_bounds.npy", np.array(rows))
    return root


def test_rows_follow_the_sorted_names_of_photographs(tmp_path):
    names = ["c.jpg", "a.JPG", "b.png"]
    scene = llff.read(write(tmp_path, [llff_row((i, 0, 0)) for i in range(3)], names))
    assert list(scene.cameras) == sorted(names)
    assert [c.center[0] for c in scene.cameras.values()] == [0, 1, 2]
    assert (scene.read("b.png").image[..., 0] == 3).all()


def test_intrinsics_scale_with_shrunk_photographs(tmp_path):
    rows = [llff_row(size=(3024, 4032), focal=3200.0)]
    write(tmp_path, rows, ["a.png"], "images_4", (1008, 756))
    write(tmp_path, rows, ["a.png"], "images_8", (504, 378))
    for settings, factor in (({}, 4), ({"images": "images_8"}, 8)):
        camera = load("llff", tmp_path, **settings).read("a.png").camera
        assert (camera.width, camera.height) == (4032 // factor, 3024 // factor)
        assert np.allclose(camera.K[[0, 1], [0, 1]], 3200 / factor)
        assert np.allclose(camera.K[:2, 2] * factor, (2016, 1512))


@pytest.mark.parametrize(
    ("rows", "refusal"),
    [
        (np.zeros((2, 16)), r"found float64 (2, 16), expected a row of 17 numbers"),
        ([llff_row()], "has 1 rows, but"),
        ([llff_row(), [*llff_row()[:15], 3, np.nan]], "'b.png': has 96x64 pixels, or NaN"),
        ([llff_row(), llff_row(near=3, far=2)], "row of 'b.png': camera far: found 2.0"),
        ([llff_row(), llff_row(size=(WIDTH, HEIGHT))], "'b.png': has 64x96 pixels"),
        ([llff_row(), llff_row(focal=0.8)], "'b.png': focal length x is 0.8"),
        (pickle.dumps(np.zeros((2, 17))), "is no array of numbers"),
        (b"\x93NUMPY junk", "is no array of numbers"),
        ([{}], "is no array of numbers"),  # NumPy pickles objects
    ],
)
def test_read_error_names_damaged_poses(tmp_path, rows, refusal):
    write(tmp_path, rows, ["a.png", "b.png"])
    file = tmp_path / "poses_bounds.npy"
    if isinstance(rows, bytes):
        file.write_bytes(rows)
    with pytest.raises(InputError) as error:
        llff.read(tmp_path)
    assert str(error.value).startswith(f"{file}: ") and refusal in str(error.value)


def test_matches_of_a_real_scene_lie_on_epipolar_lines(real_data):
    scene = llff.read(real_data / "fern")
    assert len(scene.cameras) == 20
    a, b = (scene.read(name) for name in ("image000.png", "image003.png"))
    at_a, at_b = sift_matches(*(view.image.mean(2).astype(np.uint8) for view in (a, b)))
    relative = Relative.between(a.camera, b.camera)
    distance = np.abs(relative.epipolar_distance(at_a, at_b))
    assert len(at_a) > 100
    assert np.median(distance) < 0.6
    # The file's depths are percentiles of COLMAP's points: nearly all matches lie between them.
    depth = 1 / relative.triangulate(at_a[distance < 1], at_b[distance < 1])
    assert ((depth > 0.8 * a.camera.near) & (depth < 2 * a.camera.far)).mean() > 0.95
