from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drawn_views import SIZE, canvas, view
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.masks import load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.configs import folder_digest
from slgaussian.masks.precomputed import Precomputed


def draw_ids(top, seed=0, size=SIZE):
    """Blocks of ids up to ``top``, with holes."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(1, top + 1, (size[0] // 8, size[1] // 8))
    coarse[rng.random(coarse.shape) < 0.2] = 0
    coarse[0, 0] = top
    return np.kron(coarse, np.ones((8, 8), np.int64))


def write_grey(file, ids, dtype=np.uint8):
    Image.fromarray(ids.astype(dtype)).save(file)


def write_palette(file, ids):
    image = Image.fromarray(ids.astype(np.uint8), mode="P")
    image.putpalette(np.random.default_rng(1).integers(0, 256, 768).astype(np.uint8).tobytes())
    image.save(file)


def write_colors(file, ids):
    channels = [ids % 256, ids // 256 % 256, ids >> 16]
    Image.fromarray(np.stack(channels, -1).astype(np.uint8)).save(file)


@pytest.mark.parametrize(
    ("write", "name", "top"),
    [
        (write_grey, "a.png", 255),
        (partial(write_grey, dtype=np.uint16), "a.png", 40_000),
        (write_palette, "a.png", 200),
        (write_colors, "a.png", 2**24 - 1),
        (np.save, "a.npy", 2**31 - 1),
    ],
)
def test_propagate_reads_ids_of_every_format(tmp_path, write, name, top):
    ids = draw_ids(top)
    write(tmp_path / name, ids)
    result = load_tracker("precomputed", folder=tmp_path).propagate(view(canvas()))
    assert result.dtype == np.int32
    np.testing.assert_array_equal(result, ids)


def test_associate_keeps_ids_and_holes_of_files_without_proposer(tmp_path):
    class Never:
        def propose(self, frame, mask=None):
            raise AssertionError

    views = [view(canvas()), view(canvas(seed=1), "sub/b.jpg")]
    maps = [draw_ids(700, seed) for seed in (0, 1)]
    write_grey(tmp_path / "a.png", maps[0], np.uint16)
    np.save(tmp_path / "b.npy", maps[1].astype(np.uint16))
    result = associate(views, Never(), Precomputed(folder=tmp_path))
    np.testing.assert_array_equal(result.labels, maps)
    assert (result.margin == 1).all()
    both = np.intersect1d(*maps)
    assert not np.isin(result.seen_once, both).any()
    assert set(result.seen_once) | set(both) - {0} == set(result.ids)
    assert result.areas().sum() == (np.stack(maps) > 0).sum()


def test_map_in_folder_of_view_goes_before_bare_name(tmp_path):
    (tmp_path / "left").mkdir()
    write_grey(tmp_path / "left" / "1.png", np.full(SIZE, 7))
    write_grey(tmp_path / "1.png", np.full(SIZE, 9))
    tracker = Precomputed(folder=tmp_path)
    names = ["left/1.jpg", "right/1.jpg"]
    left, right = (view(canvas(), name) for name in names)
    assert (tracker.propagate(left) == 7).all()
    assert (tracker.propagate(right) == 9).all()
    right = replace(right, view=right.view.among(names))
    with pytest.raises(InputError, match=r"1.png: fits two.*'right/1.jpg' and 'left/1.jpg'"):
        tracker.propagate(right)


def test_folder_digest_ignores_other_files(tmp_path):
    before = folder_digest(tmp_path)
    (tmp_path / "notes.txt").write_text("made elsewhere")
    assert folder_digest(tmp_path) == before


def test_missing_folder_raises_input_error(tmp_path):
    for settings, says in ({}, "none given"), ({"folder": tmp_path / "no"}, "there is no folder"):
        with pytest.raises(InputError, match=says):
            Precomputed(**settings)


def _two_maps(file):
    write_grey(file, draw_ids(9))
    np.save(file.with_suffix(".npy"), draw_ids(9))


@pytest.mark.parametrize(
    ("name", "write", "says"),
    [
        (None, None, "has no id map of view 'a'; expected a.png or a.npy"),
        ("a.png", lambda f: f.write_bytes(b"no picture"), "cannot be read as ids"),
        ("a.png", lambda f: f.write_bytes(b""), "cannot be read as ids"),
        ("a.npy", lambda f: f.write_bytes(b"no array"), "cannot be read as ids"),
        ("a.npy", lambda f: np.save(f, np.zeros(SIZE)), "found float64, expected whole numbers"),
        ("a.npy", lambda f: np.save(f, np.full(SIZE, -1)), "found ids from -1"),
        ("a.npy", lambda f: np.save(f, np.full(SIZE, 2**31)), "found ids from 2147483648"),
        ("a.npy", lambda f: np.save(f, np.zeros((4, *SIZE), int)), r"expected ids \[H, W\]"),
        ("a.npy", lambda f: np.save(f, np.zeros((0, 3), int)), r"expected ids \[H, W\]"),
        ("a.npy", lambda f: np.save(f, np.zeros(SIZE[::-1], int).T[:20]), "160x20, of another"),
        ("a.png", lambda f: Image.new("RGBA", SIZE[::-1]).save(f), "PNG of RGBA with 8 bits"),
        ("a.npy", lambda f: np.save(f, np.zeros(SIZE[::-1], int)), "120x160, of another shape"),
        ("a.png", _two_maps, r"a\.npy is there too"),
    ],
)
def test_invalid_id_map_is_refused_in_one_sentence(tmp_path, name, write, says):
    if name:
        write(tmp_path / name)
    with pytest.raises(InputError, match=says):
        Precomputed(folder=tmp_path).propagate(view(canvas()))
