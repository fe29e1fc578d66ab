"""Camera files of RealEstate10K with the frames that lie at hand."""

import numpy as np
import pytest
from PIL import Image
from posed_folders import write_cameras

from slgaussian import datasets
from slgaussian.datasets import re10k, re10k_text
from slgaussian.datasets.recognise import EXPECTED, posed_scene, recognise
from slgaussian.errors import InputError

URL = "https://www.youtube.com/watch?v=x"


ROW = "0.482334223 0.857483078 0.5 0.5 0 0 0.999946535 0.001759072 -0.010192509 -0.024142185 "
ROW += "-0.001751103 0.999998152 0.000790767 0.009485262 0.010193882 -0.000772876 0.999947727 "
ROW += "-0.347580573"


@pytest.fixture
def clip(tmp_path):
    """A camera file of four frames, three of which are there."""
    rows = np.zeros((4, 18), np.float32)
    rows[:, :4] = (0.5, 0.9, 0.5, 0.5)
    rows[:, 6:] = np.eye(4)[:3].ravel()
    rows[:, 9] = np.arange(4) / 10
    times = np.arange(4) * 33_333 + 100
    made = re10k.Clip("0123abcd", URL, times, rows, ())
    write_cameras(tmp_path / "0123abcd.txt", made)
    (tmp_path / "0123abcd").mkdir()
    for time in times[[0, 1, 3]]:
        pixels = np.full((20, 40, 3), time % 251, np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"0123abcd/{time}.png")
    return tmp_path / "0123abcd.txt"


def test_a_scene_has_the_frames_that_are_there(clip):
    scene = datasets.load("re10k_text", clip)
    assert scene.name == "0123abcd"
    assert list(scene.cameras) == ["100.png", "33433.png", "100099.png"]
    view = scene.read("100099.png")
    assert view.image.shape == (20, 40, 3) and (view.image == 100099 % 251).all()
    np.testing.assert_allclose(view.camera.K, [[20, 0, 20], [0, 18, 10], [0, 0, 1]], atol=1e-5)
    np.testing.assert_allclose(view.camera.center, [-0.3, 0, 0], atol=1e-6)
    assert scene.sources("100.png") == [clip, clip.parent / "0123abcd/100.png"]


def test_it_is_known_by_its_first_line(clip):
    assert recognise(clip) == ("re10k_text", clip)
    assert list(posed_scene(clip)[0].cameras) == ["100.png", "33433.png", "100099.png"]
    (clip.parent / "notes.txt").write_text("no address")
    with pytest.raises(InputError, match="is no file of cameras") as refused:
        recognise(clip.parent / "notes.txt")
    assert EXPECTED in str(refused.value)


def test_pixels_and_distortion_are_refused_and_a_missing_address_swallows_no_frame(clip):
    address, *rows = clip.read_text().splitlines()
    clip.write_text("\n".join(rows))
    assert len(re10k_text.read(clip).cameras) == 3
    words = rows[0].split()
    for place, value, sentence in (
        (1, "20.0", r"focal length x is 20, .* 2\.86 degrees, .* likely in pixels"),
        (3, "20.0", r"principal point is \(20, 0\.5\), .* likely in pixels"),
        (5, "0.1", r"numbers 5 and 6 are 0\.1 and 0, expected 0"),
    ):
        changed = [*words[:place], value, *words[place + 1 :]]
        clip.write_text("\n".join([address, " ".join(changed), *rows[1:]]))
        with pytest.raises(InputError, match=rf"0123abcd\.txt: frame 100: .*{sentence}"):
            re10k_text.read(clip)


def test_too_few_frames_are_one_sentence(clip):
    for file in sorted(clip.with_suffix("").iterdir())[1:]:
        file.unlink()
    with pytest.raises(InputError, match=r"found 1 of its 4 frames in .*called by their times"):
        re10k_text.read(clip)


def test_a_raw_camera_file(tmp_path):
    file = tmp_path / "000c3ab189999a83.txt"
    file.write_text(f"https://example.org/watch?v=1\n45979267 {ROW}\n46012633 {ROW}\n")
    address, times, rows = re10k_text.read_cameras(file)
    assert address == "https://example.org/watch?v=1" and times.tolist() == [45979267, 46012633]
    camera = re10k.camera_of(rows[0], 640, 360)
    assert camera.K[0, 0] == pytest.approx(0.482334223 * 640)
    assert camera.w2c[2, 3] == pytest.approx(-0.347580573)
