"""Lens, focal length and orientation from EXIF headers, and damaged headers."""

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps
from taken_photographs import write_photograph

from slgaussian.datasets.unposed import photograph

TAGS = ExifTags.Base
DIAGONAL = float(np.hypot(400, 300))


@pytest.fixture
def pixels():
    """An upright landscape photograph with a bright top left quarter, uint8 [300, 400, 3]."""
    pixels = np.full((300, 400, 3), 60, np.uint8)
    pixels[:150, :200] = 200
    return pixels


FILM, WIDE, HIGH = TAGS.FocalLengthIn35mmFilm, TAGS.ExifImageWidth, TAGS.ExifImageHeight
SENSOR = {
    # 4000 pixels of a sensor 8 mm wide, stored here at 400.
    TAGS.FocalLength: 6.0,
    TAGS.FocalPlaneXResolution: 5000.0,
    TAGS.FocalPlaneYResolution: 5000.0,
    TAGS.FocalPlaneResolutionUnit: 3,
    WIDE: 4000,
    HIGH: 3000,
}
PER_INCH = {TAGS.FocalPlaneXResolution: 12700.0, TAGS.FocalPlaneYResolution: 12700.0}
FOCAL_TAGS = {
    "film": ({FILM: 26}, 26 * DIAGONAL / 43.27),
    "zoomed": ({FILM: 36, TAGS.DigitalZoomRatio: 1.5}, 36 * DIAGONAL / 43.27),
    "zero": ({FILM: 0}, None),
    "too short": ({FILM: 2}, None),
    "too long": ({FILM: 2000}, None),
    "millimetres alone": ({TAGS.FocalLength: 4.2}, None),
    "sensor": (SENSOR, 300.0),
    "sensor, in inches": (SENSOR | PER_INCH | {TAGS.FocalPlaneResolutionUnit: 2}, 300.0),
    "sensor, zoomed": (SENSOR | {TAGS.DigitalZoomRatio: 1.5}, 450.0),
    "half the rows": (SENSOR | {TAGS.FocalPlaneYResolution: 2500.0}, None),
    "cropped": ({FILM: 26, WIDE: 400, HIGH: 400}, None),
}


@pytest.mark.parametrize(("tags", "focal"), FOCAL_TAGS.values(), ids=FOCAL_TAGS)
def test_focal_length(tmp_path, pixels, tags, focal):
    actual = photograph(write_photograph(tmp_path / "a.jpg", pixels, 6, exif=tags), "a").focal
    assert actual == (None if focal is None else pytest.approx(focal))


def test_lens_names_differ_between_zooms(tmp_path, pixels):
    base = {TAGS.Make: "Apple", TAGS.Model: "iPhone X"}
    lenses = set()
    for number, film in enumerate((28, 28, 36)):
        exif = {TAGS.FocalLength: 4.0, FILM: film, TAGS.LensModel: "back 4mm"}
        file = write_photograph(tmp_path / f"{number}.jpg", pixels, base=base, exif=exif)
        lenses.add(photograph(file, "a").lens)
    assert lenses == {
        "Apple, iPhone X, back 4mm, 4 mm, 28 mm of 35",
        "Apple, iPhone X, back 4mm, 4 mm, 36 mm of 35",
    }
    assert photograph(write_photograph(tmp_path / "b.png", pixels), "b").lens == ""


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_orientation_is_applied_as_by_pillow(tmp_path, pixels, orientation, suffix):
    image, file = Image.fromarray(pixels), tmp_path / f"a{suffix}"
    image.getexif()[TAGS.Orientation] = orientation
    image.save(file, exif=image.getexif())
    expected = np.asarray(ImageOps.exif_transpose(image))
    actual = photograph(file, "a")
    assert actual.image.shape == expected.shape == (actual.height, actual.width, 3)
    assert np.abs(actual.image.astype(int) - expected).max() < 30


def test_large_photograph_is_shrunk_without_a_shift(tmp_path):
    # The size is no multiple of JPEG's decoding scales: an edge at .4 of the width stays there.
    pixels = np.full((2003, 5005, 3), 40, np.uint8)
    pixels[:, :2002] = 220
    shrunk = photograph(write_photograph(tmp_path / "a.jpg", pixels), "a")
    assert shrunk.image.shape == (480, 1200, 3) and (shrunk.width, shrunk.height) == (5005, 2003)
    row = shrunk.image[240, :, 0].astype(float)
    assert ((row - 40) / 180).sum() == pytest.approx(480, abs=0.15)


@pytest.mark.filterwarnings("ignore::UserWarning")  # Pillow warns of tags that it skips
def test_photograph_ignores_damaged_exif_header(tmp_path, pixels):
    tags = {TAGS.Make: "A"}, {FILM: 26, TAGS.LensModel: "x"}
    data = bytearray(write_photograph(tmp_path / "a.jpg", pixels, 6, *tags).read_bytes())
    start = data.index(b"Exif")
    end = start - 2 + int.from_bytes(data[start - 2 : start], "big")
    rng = np.random.default_rng(0)
    for _ in range(60):
        bad = data.copy()
        for at in rng.integers(start + 14, end, 8):
            bad[at] = rng.integers(0, 256)
        (tmp_path / "b.jpg").write_bytes(bad)
        actual = photograph(tmp_path / "b.jpg", "b")
        assert {actual.width, actual.height} == {400, 300}
        assert actual.focal is None or 120 < actual.focal < 8000
