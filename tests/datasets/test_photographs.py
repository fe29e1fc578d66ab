"""Folders of photographs: what is read, what is passed over, and masks in the layouts of others."""

import json
import os
import shutil

import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, WIDTH, Shot, llff_row, write_model, write_pictures
from test_unposed import find_calls  # noqa: F401 - a fixture

from slgaussian import datasets
from slgaussian.datasets import unposed
from slgaussian.datasets.photographs import find_file, photographs_in
from slgaussian.errors import InputError


def test_photographs_in_lists_every_format_and_warns_of_other_files(tmp_path):
    names = ["a.Jpg", "b.webp", "c.tif", "d.JPEG", "e.BMP", "f.TIFF", "g.pnm", "plant_mask.png"]
    write_pictures(tmp_path, names)
    for name in ("._a.jpg", ".DS_Store", "Thumbs.db", "x.cr2", "x.gif", "x.mp4", "x.txt", "x.avif"):
        (tmp_path / name).write_bytes(b"")
    for name in ("dynamic_mask_a.png", "b_mask.png", "c.tif.mask.png"):
        shutil.copy(tmp_path / "a.Jpg", tmp_path / name)
    with pytest.warns(UserWarning, match=r"over, 4: x\.avif, x\.cr2, x\.gif, x\.mp4; save"):
        assert [path.name for path in photographs_in(tmp_path)] == names


def test_find_file_accepts_suffix_of_any_case_and_format(tmp_path):
    write_pictures(tmp_path, ["a.Jpg", "b.v2.webp", "c.png", "c.TIF"])
    for name, found in (("a", "a.Jpg"), ("a.png", "a.Jpg"), ("b.v2", "b.v2.webp"), ("d", None)):
        path = find_file(tmp_path / name)
        assert (path and path.name) == found
    with pytest.raises(InputError, match=r"c\.bmp: may be c\.TIF or c\.png"):
        find_file(tmp_path / "c.bmp")


@pytest.mark.usefixtures("find_calls")
def test_load_leaves_out_unreadable_and_tiny_photographs_of_a_folder(tmp_path):
    write_pictures(tmp_path, ["a.png", "b.jpg", "c.png"], 480, 320)
    write_pictures(tmp_path, ["tiny.png"], 60, 40)
    os.truncate(tmp_path / "b.jpg", 2000)
    with pytest.warns(UserWarning) as caught:
        scene = datasets.load("photographs", tmp_path)
    assert list(scene.cameras) == ["a.png", "c.png"]
    texts = sorted(str(warning.message).removeprefix(str(tmp_path)) for warning in caught)
    assert texts[0].startswith("/b.jpg: cannot be read (") and "left out" in texts[0]
    assert texts[1].startswith("/tiny.png: has 2400 pixels, far fewer") and len(texts) == 2
    with pytest.raises(InputError, match=r"b\.jpg: cannot be read"):
        unposed.read([tmp_path / "a.png", tmp_path / "b.jpg"])
    assert len(unposed.read([tmp_path / "a.png", tmp_path / "tiny.png"]).cameras) == 2


@pytest.mark.parametrize(
    ("place", "refusal"),
    [("walk.MP4", r"is a film; .* `ffmpeg -i .*walk\.MP4 -vf"), ("a.dng", "is a raw file")],
)
def test_film_or_raw_file_error_says_what_to_do(tmp_path, place, refusal):
    (tmp_path / place).write_bytes(b"")
    for places in ([tmp_path / place], [tmp_path]):
        with pytest.raises(InputError, match=refusal):
            unposed.name_files(places)


def write_scene(format, root):
    write_pictures(root / "images", ["a.jpg", "b.jpg"])
    if format == "colmap":
        write_model(root / "sparse/0", {n: Shot(i + 1) for i, n in enumerate(["a.jpg", "b.jpg"])})
    elif format == "llff":
        np.save(root / "poses_bounds.npy", [llff_row(), llff_row((1, 0, 0))])
    elif format == "nerfstudio":
        frames = [
            {"file_path": f"../{root.name}/images/{n}.jpg", "transform_matrix": np.eye(4).tolist()}
            for n in "ab"
        ]
        content = {"fl_x": 80.0, "w": WIDTH, "h": HEIGHT, "frames": frames}
        (root / "transforms.json").write_text(json.dumps(content))
    return root


VALID = np.zeros((HEIGHT, WIDTH), bool)
VALID[10:50, 20:70] = True


@pytest.mark.parametrize("format", ["colmap", "llff", "nerfstudio", "photographs"])
@pytest.mark.parametrize(
    ("file", "black", "scale"),
    [
        ("masks/a.jpg.png", False, 1),
        ("masks/a.png", False, 2),
        ("mask/a.png", False, 1),
        ("images/masks/a.png", False, 1),
        ("masks_2/a.png", False, 0.5),
        ("images/dynamic_mask_a.png", True, 1),
        ("images/a_mask.png", False, 1),
    ],
)
@pytest.mark.usefixtures("find_calls")
def test_every_reader_applies_mask_beside_a_photograph(tmp_path, format, file, black, scale):
    write_scene(format, tmp_path)
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray((VALID ^ black) * np.uint8(255))
    image.resize((int(WIDTH * scale), int(HEIGHT * scale)), 0).save(tmp_path / file)
    with pytest.warns(UserWarning, match="masks of 1 of 2 photographs are read"):
        scene = datasets.load(format, tmp_path)
    masked, other = (scene.read(scene.find(name)) for name in "ab")
    assert (masked.opaque == VALID).all() and other.opaque is None
    assert not masked.image[~VALID].any() and (masked.image[VALID] > 0).any()
    files, _ = datasets.inputs(format, tmp_path, [scene.find("a")])
    assert tmp_path / file in files


@pytest.mark.parametrize(
    ("levels", "opaque", "warning"),
    [
        (np.zeros_like(VALID), 0.0, "masks all of its photograph"),
        (
            np.arange(VALID.size).reshape(VALID.shape) % 9,
            None,
            "is passed over",
        ),
        (VALID * 1, VALID.mean(), None),
    ],
)
def test_view_ignores_mask_of_ids_and_warns_about_a_black_one(tmp_path, levels, opaque, warning):
    write_scene("llff", tmp_path)
    (tmp_path / "masks").mkdir()
    Image.fromarray(levels.astype(np.uint8)).save(tmp_path / "masks/b.png")
    with pytest.warns(UserWarning, match="of 1 of 2"):
        scene = datasets.load("llff", tmp_path)
    if warning is None:
        view = scene.read("b.jpg")
    else:
        with pytest.warns(UserWarning, match=warning):
            view = scene.read("b.jpg")
    assert (view.opaque is None) if opaque is None else view.opaque.mean() == opaque


def test_load_refuses_two_masks_of_a_photograph(tmp_path):
    write_scene("llff", tmp_path)
    write_pictures(tmp_path, ["masks/c.png"])
    with pytest.warns(UserWarning, match="masks of 0 of 2 photographs are read"):
        datasets.load("llff", tmp_path)
    write_pictures(tmp_path, ["masks/a.png", "images/dynamic_mask_a.png"])
    with pytest.raises(InputError, match="masks the same photograph; remove one"):
        datasets.load("llff", tmp_path)
    (tmp_path / "images/dynamic_mask_a.png").unlink()
    write_pictures(tmp_path, ["masks/a.jpg.png"])
    with pytest.raises(InputError, match=r"a\.jpg\.png is there too"):
        datasets.load("llff", tmp_path)
