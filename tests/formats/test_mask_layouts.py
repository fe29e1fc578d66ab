"""Masks in the layouts of Gaussian Grouping and LangSplat, as their loaders read them.

Neither loader can be installed from PyPI; what they do with a file is restated here.
"""

import numpy as np
import pytest
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.formats.mask_layouts import (
    loader_names,
    recognise_layout,
    write_grouping,
    write_langsplat,
)
from slgaussian.formats.resampling import Window
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank
from slgaussian.scene import Camera, View

HEIGHT, WIDTH = 24, 32


def make_view(name="images/a.jpg", photo=(3 * HEIGHT, 3 * WIDTH)) -> View:
    window = Window.whole(*photo[::-1])
    camera = Camera(np.diag([30, 30, 1.0]), np.eye(4), WIDTH, HEIGHT)
    return View(name, camera, np.zeros((HEIGHT, WIDTH, 3), np.uint8), window=window)


def make_maps(*labels) -> LabelMaps:
    stack = np.array(labels, np.int32)
    return LabelMaps(stack, np.ones(stack.shape, np.float32))


def make_blocks(ids) -> np.ndarray:
    """Return a label map with a block for each of 12 ids."""
    return np.kron(np.reshape(ids, (3, 4)), np.ones((8, 8), int))


@pytest.mark.parametrize("shift", [0, 1000])
def test_write_grouping_is_8_bits_of_the_size_of_the_photograph(tmp_path, shift):
    ids = np.arange(12) + shift * (np.arange(12) > 0)
    maps = make_maps(make_blocks(ids), make_blocks(ids[::-1]))
    views = [make_view("images/a.jpg"), make_view("images/b.JPG")]
    if shift:
        with pytest.warns(UserWarning, match="ids above 255"):
            write_grouping(tmp_path, views, maps)
    else:
        write_grouping(tmp_path, views, maps)
    for view, labels in zip("ab", maps.labels, strict=True):
        # Its loader opens the PNG with the photograph's stem and takes the values as classes.
        image = Image.open(tmp_path / "object_mask" / f"{view}.png")
        assert image.mode == "L" and image.size == (3 * WIDTH, 3 * HEIGHT)
        small = np.array(image)[1::3, 1::3].astype(int)
        np.testing.assert_array_equal(small, labels - shift * (labels > 0))


@pytest.mark.filterwarnings("ignore:ids above 255")
def test_write_grouping_keeps_the_255_largest_objects(tmp_path):
    labels = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 300 + 1
    labels[labels == 3] = 2  # object 2 is the largest, 3 is not there
    with pytest.warns(UserWarning, match="299 objects: .*, so the 44 smallest are left out"):
        write_grouping(tmp_path, [make_view(photo=(HEIGHT, WIDTH))], make_maps(labels))
    mask = np.array(Image.open(tmp_path / "object_mask" / "a.png"))
    assert len(np.unique(mask[mask > 0])) == 255 and (mask[labels == 2] == 2).all()


def make_bank(levels: bool) -> MemoryBank:
    """Return a bank of 11 objects in two views, each with its number as a direction."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(13, 2, 5))
    features = (features / np.linalg.norm(features, axis=-1, keepdims=True)).astype(np.float32)
    own = np.arange(11)
    groups = np.stack([np.where(own < 8, 11, own), np.where(own < 2, 12, own)]).astype(np.int32)
    more = {"levels": groups, "group_features": features[11:]} if levels else {}
    codes = rng.uniform(size=(11, 3)).astype(np.float32)
    present = np.ones((11, 2), bool)
    return MemoryBank(np.arange(1, 12, dtype=np.int32), codes, features[:11], present, **more)


@pytest.mark.filterwarnings("ignore:features have 5 numbers")
@pytest.mark.parametrize("levels", [False, True])
@pytest.mark.parametrize(("photo", "size"), [((72, 96), (72, 96)), ((2160, 2880), (1080, 1440))])
def test_write_langsplat_gives_each_pixel_the_feature_of_its_object(tmp_path, levels, photo, size):
    bank = make_bank(levels)
    maps = make_maps(make_blocks(np.arange(12)), make_blocks([0, 3, 4] * 4))
    write_langsplat(tmp_path, [make_view("a.jpg", photo), make_view("b.jpg", photo)], maps, bank)
    # Default, small, middle (groups of two), large (groups of eight).
    own = np.arange(11)
    nodes = [own, own, *((bank.levels[1], bank.levels[0]) if levels else (own, own))]
    for number, name in enumerate("ab"):
        segments = np.load(tmp_path / "language_features" / f"{name}_s.npy")
        features = np.load(tmp_path / "language_features" / f"{name}_f.npy")
        assert segments.dtype == np.int32 and segments.shape == (4, *size)
        assert features.dtype == np.float32 and len(features) == segments.max() + 1
        step = size[0] // HEIGHT
        labels, start = maps.labels[number], 0
        for level, rows in zip(segments, nodes, strict=True):
            # Its loader takes the rows of one level's segments, and masks -1.
            assert level[level >= 0].min() == start  # the rows of a level follow the last one's
            start = level.max() + 1
            level = level[step // 2 :: step, step // 2 :: step]
            np.testing.assert_array_equal(level == -1, labels == 0)
            expected = bank.nodes[0][rows[labels[labels > 0] - 1], number]
            np.testing.assert_array_equal(features[level[labels > 0]], expected)


@pytest.mark.parametrize(
    ("names", "reason"),
    [(["l/1.jpg", "r/1.jpg"], "'r/1.jpg' has that name too"), (["f.01.jpg"], "has a dot")],
)
def test_loader_names_refuses_names_that_loaders_confuse(names, reason):
    with pytest.raises(InputError, match=reason):
        loader_names([make_view(name) for name in names])


FILES = {
    "gaussian-grouping": ["object_mask/a.png"],
    "langsplat": ["language_features/a_s.npy", "language_features/a_f.npy"],
    "coco": ["annotations.json"],
    "ids": ["a.png", "look.jpg", "masks.json"],
}


def make_files(folder, names) -> None:
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        is_coco = name == "annotations.json"
        (folder / name).write_text('{"images": [], "annotations": []}' if is_coco else "{}")


@pytest.mark.parametrize("layout", FILES)
@pytest.mark.parametrize("other", FILES)
def test_recognise_layout_refuses_a_folder_with_two(tmp_path, layout, other):
    make_files(tmp_path, FILES[layout])
    make_files(tmp_path, FILES[other])
    if layout == other:
        place = tmp_path / FILES[layout][0]
        expected = place if layout == "coco" else place.parent
        assert recognise_layout(tmp_path) == (layout, expected)
    else:
        with pytest.raises(InputError, match=f"(?=.*{layout})(?=.*{other})"):
            recognise_layout(tmp_path)


def test_recognise_layout_takes_an_id_map_called_like_segments_for_ids(tmp_path):
    make_files(tmp_path, ["chair_s.npy", "table.npy"])
    assert recognise_layout(tmp_path) == ("ids", tmp_path)
