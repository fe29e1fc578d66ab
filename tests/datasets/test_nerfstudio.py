"""transforms.json of nerfstudio: intrinsics, depth, masks, camera paths and refusals."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, WIDTH, picture, write_pictures

from slgaussian.datasets import nerfstudio
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import write_map

INTRINSICS = {"fl_x": 80.0, "fl_y": 82.0, "cx": 47.3, "cy": 33.1, "w": WIDTH, "h": HEIGHT}
IDENTITY = np.eye(4).tolist()


def frame(name: str, **keys) -> dict:
    return {"file_path": name, "transform_matrix": IDENTITY, **keys}


def write(root: Path, frames: list, images=("a.png",), **top) -> Path:
    """Write images and transforms.json, whose path is returned."""
    write_pictures(root, images)
    file = root / "transforms.json"
    file.write_text(json.dumps({**INTRINSICS, **top, "frames": frames}))
    return file


def test_read_takes_missing_sizes_and_suffixes_from_photographs(tmp_path):
    frames = [frame("./a"), frame("b.png")]
    scene = nerfstudio.read(write(tmp_path, frames, ("a.WebP", "b.png"), w=None, cy=None))
    for camera in scene.cameras.values():
        assert camera.K.tolist() == [[80, 0, 47.3], [0, 82, 32], [0, 0, 1]]
    assert scene.read(scene.find("a")).image.shape == picture(0).shape
    (tmp_path / "a.jpg").write_bytes((tmp_path / "a.WebP").read_bytes())
    with pytest.raises(InputError, match=r"a: may be a\.WebP or a\.jpg; remove"):
        nerfstudio.read(tmp_path)


WIDE = 2 * np.arctan(WIDTH / 2 / 90)  # angle of a focal length of 90 pixels


@pytest.mark.parametrize(
    ("keys", "top", "expected", "contradiction"),
    [
        (
            {"camera_angle_x": WIDE},
            {},
            (90, 90, 47.3, 33.1),
            "camera_angle_x of a frame contradict",
        ),
        ({"fl_y": 100.0}, {}, (100, 100, 47.3, 33.1), "fl_y of a frame contradict fl_x, fl_y of"),
        ({"cx": 10.0}, {}, (80, 82, 10, 32), "cx of a frame contradict cx, cy of the file"),
        ({"fl_x": 80.0, "fl_y": 82.1}, {}, (80, 82.1, 47.3, 33.1), None),
        ({"fl_x": 90.0}, {"fl_x": None, "fl_y": None, "x_fov": 70.0}, (90, 90, 47.3, 33.1), "fl_x"),
        ({"camera_angle_x": WIDE}, {"fl_x": None, "fl_y": None}, (90, 90, 47.3, 33.1), None),
        ({}, {"fl_y": None, "y_fov": np.degrees(WIDE)}, None, "focal lengths of 'a.png' are 80"),
    ],
)
def test_part_of_a_lens_is_taken_whole_from_one_level(tmp_path, keys, top, expected, contradiction):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        K = nerfstudio.read(write(tmp_path, [frame("a.png", **keys)], **top)).cameras["a.png"].K
    if expected is not None:
        assert (K[0, 0], K[1, 1], K[0, 2], K[1, 2]) == pytest.approx(expected)
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == (contradiction is not None)
    assert all(contradiction in message for message in messages)


def test_distortion_of_a_frame_replaces_that_of_the_file(tmp_path):
    images = []
    for top, keys in (({"k1": 0.1, "k2": 0.5}, {"k1": 0.2}), ({}, {"k1": 0.2}), ({"k1": 0.2}, {})):
        scene = nerfstudio.read(write(tmp_path, [frame("a.png", **keys)], **top))
        if top and keys:
            with pytest.warns(UserWarning, match="k1 of a frame contradict k1, k2 of the file"):
                scene.read("a.png")
        images.append(scene.read("a.png").image)
    assert (images[0] == images[1]).all() and (images[1] == images[2]).all()


def read_depth(tmp_path, values, **top) -> np.ndarray | None:
    name = {"u2": "d.png", "f4": "d.tiff"}.get(values.dtype.str[1:], "d.npy")
    if name == "d.npy":
        np.save(tmp_path / name, values)
    else:
        Image.fromarray(values).save(tmp_path / name)
    file = write(tmp_path, [frame("a.png", depth_file_path=name)], **top)
    return nerfstudio.read(file).read("a.png").depth


def test_depth_is_in_millimetres_by_default(tmp_path):
    raw = np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH)
    scales = {"depth_unit_scale_factor": 0.25}, {"applied_scale": 0.5}
    for top, factor in zip(({}, *scales), (0.001, 0.25, 0.0005), strict=True):
        for values in (raw, *map(raw.astype, (float, np.float32, np.int32))):
            depth = read_depth(tmp_path, values, **top)
            assert depth.dtype == np.float32 and depth == pytest.approx(raw * factor)
    partial = np.full((HEIGHT, WIDTH), 1500.0)
    partial[0, :4] = (np.nan, np.inf, -3, 0)
    assert read_depth(tmp_path, partial)[0, :5].tolist() == [0, 0, 0, 0, 1.5]


def test_depth_is_resampled_at_pixel_centres_and_undistorted_without_new_values(tmp_path):
    def plane(height, width):
        """Depth of a plane: its inverse is affine over the image."""
        y, x = np.mgrid[:height, :width] + 0.5
        return 1 / (0.3 + 0.2 * x / width + 0.1 * y / height)

    with pytest.raises(InputError, match=r"d\.npy: is 64x96, of another shape than its"):
        read_depth(tmp_path, np.ones((WIDTH, HEIGHT)))
    depth = read_depth(tmp_path, plane(HEIGHT // 2, WIDTH // 2), depth_unit_scale_factor=1)
    np.testing.assert_allclose(depth, plane(HEIGHT, WIDTH), rtol=1e-6)
    step = np.full((HEIGHT, WIDTH), 2000, np.uint16)
    step[:, WIDTH // 2 :] = 5000
    assert set(np.unique(read_depth(tmp_path, step, k1=0.3))) == {0, 2, 5}


def test_unreadable_depth_gives_a_warning_and_a_view_without_depth(tmp_path):
    colours = r"d\.npy: is float64 \(64, 96, 3\), expected one .*; the view is read without depth"
    with pytest.warns(UserWarning, match=colours):
        assert read_depth(tmp_path, np.ones((HEIGHT, WIDTH, 3))) is None
    (tmp_path / "d.exr").write_bytes(b"v/1\1")
    np.savez(tmp_path / "d.npz", depth=np.full((HEIGHT, WIDTH), 1500.0))
    for name in ("d.exr", "d.npz"):
        view = nerfstudio.read(write(tmp_path, [frame("a.png", depth_file_path=name)]))
        if name == "d.npz":
            assert view.read("a.png").depth == pytest.approx(np.full((HEIGHT, WIDTH), 1.5))
            continue
        with pytest.warns(UserWarning, match=r"d\.exr: cannot be read \(EXR\); save depth as") as e:
            assert (view.read("a.png").image == picture(0)).all()
        assert "JPEG" not in str(e[0].message)


def test_unit_of_a_png_applies_unless_the_file_states_one(tmp_path):
    depth = np.linspace(50, 90, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    assert write_map(tmp_path / "d.png", depth) == 0.01
    for top in ({}, {"depth_unit_scale_factor": 0.01}):
        file = write(tmp_path, [frame("a.png", depth_file_path="d.png")], **top)
        assert nerfstudio.read(file).read("a.png").depth == pytest.approx(depth, abs=0.006)


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_view_error_names_truncated_or_resized_photograph(tmp_path, name):
    scene = nerfstudio.read(write(tmp_path, [frame(name)], (name,)))
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=rf"{name}: cannot be read"):
        scene.read(name)
    Image.new("RGB", (50, 40)).save(tmp_path / name)
    with pytest.raises(InputError, match=rf"{name}: is 50x40, but transforms.json says 96x64"):
        scene.read(name)


@pytest.mark.parametrize(
    ("frames", "top", "refusal"),
    [
        ([], {}, "lists no frames"),
        ([frame("a.png")] * 2, {}, "two frames have the file_path 'a.png'"),
        ([{"transform_matrix": IDENTITY}], {}, "frame 0 has no file_path"),
        ([{"file_path": "a.png"}], {}, "frame 'a.png': has no transform_matrix"),
        ([frame("a.png", transform_matrix=[[1, 2], [3]])], {}, "has no transform_matrix of 4x4"),
        ([frame("a.png", transform_matrix=(2 * np.eye(4)).tolist())], {}, "not a rotation"),
        ([frame("a.png", fl_x="wide")], {}, "fl_x is 'wide', expected a finite number"),
        ([frame("a.png", fl_x=-5)], {}, "focal lengths -5, -5 must be positive"),
        ([frame("a.png", w=90.5)], {}, "w and h are 90.5 and 64"),
        ([frame("a.png", w=48, h=32, cx=24, cy=16)], {}, "48x32 pixels, but fl_x, fl_y of the"),
        ([frame("a.png")], {"fl_x": None, "fl_y": None}, "neither fl_x nor camera_angle_x"),
        ([frame("a.png")], {"camera_model": "EQUIRECTANGULAR"}, "'EQUIRECTANGULAR' cannot be read"),
        ([frame("a.png")], {"is_fisheye": "false"}, "is_fisheye is 'false', expected true or"),
        ([frame("a.png", is_fisheye=True)], {"camera_model": "OPENCV"}, "is_fisheye is True"),
        ([frame("gone.png")], {"w": None}, "neither w and h nor a photograph"),
        ([frame("a.png", camera_angle_y=60.0)], {"fl_y": None}, "camera_angle_y is 60, expected"),
        ([frame("a.png", fl_x=0.8, fl_y=0.8)], {}, "focal length x is 0.8"),
        ([frame("a.png", cx=0.49, cy=0.52)], {}, "principal point is (0.49, 0.52)"),
    ],
)
def test_read_error_names_invalid_file(tmp_path, frames, top, refusal):
    file = write(tmp_path, frames, **top)
    with pytest.raises(InputError) as error:
        nerfstudio.read(file)
    assert str(error.value).startswith(f"{file}: ") and refusal in str(error.value)


@pytest.mark.parametrize(
    ("keys", "contradiction"),
    [
        ({"camera_angle_x": 1.08}, None),  # 2 atan(48 / 80) = 1.0808
        ({"y_fov": 42.6, "camera_angle_y": 0.743}, None),
        ({"camera_angle_x": 0.54}, "camera_angle_x is 0.54, but 1.08084 by the focal length x of"),
        ({"camera_angle_x": 62.0}, "camera_angle_x is 62, but 1.08084 by"),
        ({"y_fov": 60.0}, "y_fov is 60, but 42.6"),
        (
            {"fl_x": None, "fl_y": None, "camera_angle_x": 1.2, "x_fov": 60.0},
            "x_fov is 60, but 68.7549 by",
        ),
    ],
)
def test_contradicting_focal_keys_give_a_warning_and_the_first(tmp_path, keys, contradiction):
    frames = [frame("a.png"), frame("b.png")]
    first = {"fl_x": None, "fl_y": None, "camera_angle_x": 1.2} if "fl_x" in keys else {}
    K = nerfstudio.read(write(tmp_path, frames, **first)).cameras["a.png"].K
    file = write(tmp_path, frames, **keys)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        assert (nerfstudio.read(file).cameras["b.png"].K == K).all()
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == (contradiction is not None)  # one for all frames
    assert all(message.startswith(f"{file}: {contradiction}") for message in messages)


def test_view_refuses_fourth_radial_term(tmp_path):
    scene = nerfstudio.read(write(tmp_path, [frame("a.png")], k4=0.1))
    with pytest.raises(InputError, match=r"frame 'a\.png': k4 is 0\.1"):
        scene.read("a.png")


def test_sensor_depths_of_real_frames_agree(real_data):
    scene = nerfstudio.read(real_data / "office")
    a, b = (scene.read(name) for name in list(scene.cameras)[:2])
    pixels, z = b.camera.project(a.camera.unproject(a.depth))
    u, v = pixels[..., 0].round().astype(int), pixels[..., 1].round().astype(int)
    inside = (a.depth > 0) & (u >= 0) & (v >= 0) & (u < b.camera.width) & (v < b.camera.height)
    measured, projected = b.depth[v[inside], u[inside]], z[inside]
    error = np.abs(measured - projected) / projected
    assert np.median(error[measured > 0]) < 0.03


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("fisheye_crop_radius", 40.0),
        ("distortion_model", "kannala-brandt"),
        ("k5", 0.01),
        ("rolling_shutter", [0.0, 0.0, 0.03]),
        ("mask_color", [0, 0, 0]),
        ("depth_scale", 1000.0),
    ],
)
def test_read_refuses_unsupported_key_that_changes_the_image(tmp_path, key, value):
    for top, keys in (({key: value}, {}), ({}, {key: value})):
        with pytest.raises(InputError, match=rf"frame 'a\.png': {key} is "):
            nerfstudio.read(write(tmp_path, [frame("a.png", **keys)], **top))
    # A file of a single camera, as for a viewpoint.
    (tmp_path / "one.json").write_text(json.dumps(frame("a.png", **INTRINSICS, **{key: value})))
    with pytest.raises(InputError, match=rf"{key} is "):
        nerfstudio.read_cameras(tmp_path / "one.json")


@pytest.mark.parametrize("lens", [{}, {"k1": 0.2}])
def test_mask_has_the_effect_of_an_equal_alpha_channel(tmp_path, lens):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[10:50, 20:70] = 255
    mask[10, 20:70] = 100
    mask[11, 20:70] = 200
    Image.fromarray(np.dstack([picture(0), mask])).save(tmp_path / "rgba.png")
    frames = [frame("a.png", mask_path="m.png"), frame("rgba.png")]
    scene = nerfstudio.read(write(tmp_path, frames, **lens))
    with pytest.raises(InputError, match=r"m\.png: cannot be read"):
        scene.read("a.png")
    Image.fromarray(mask[:30]).save(tmp_path / "m.png")
    with pytest.raises(InputError, match=r"m\.png: is 96x30, of another shape"):
        scene.read("a.png")
    Image.fromarray(mask).save(tmp_path / "m.png")
    masked, with_alpha = scene.read("a.png"), scene.read("rgba.png")
    assert np.array_equal(masked.image, with_alpha.image)
    assert np.array_equal(masked.opaque, with_alpha.opaque)
    if not lens:
        assert np.array_equal(masked.opaque, mask >= 128)
        assert np.array_equal(masked.image, np.round(picture(0) * (mask[..., None] / 255)))


@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({"camera_type": "equirectangular"}, "expected perspective cameras"),
        ({"camera_path": []}, "has no camera"),
        ({"camera_path": [{"fov": 50}]}, "is no camera path of nerfstudio's"),
    ],
)
def test_read_cameras_refuses_unusable_camera_path(tmp_path, change, refusal):
    camera = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 50}
    content = {"render_width": 64, "render_height": 48, "camera_path": [camera]}
    (tmp_path / "path.json").write_text(json.dumps(content | change))
    with pytest.raises(InputError, match=refusal):
        nerfstudio.read_cameras(tmp_path / "path.json")
