"""Lens and orientation in EXIF headers, and nonsense there, which is left out."""

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageOps
from taken_photographs import taken

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
HEADERS = {
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


@pytest.mark.parametrize("header", HEADERS)
def test_focal_length(tmp_path, pixels, header):
    tags, focal = HEADERS[header]
    found = photograph(taken(tmp_path / "a.jpg", pixels, 6, own=tags), "a")
    assert found.focal == (None if focal is None else pytest.approx(focal))


def test_the_lens_tells_zooms_apart(tmp_path, pixels):
    base = {TAGS.Make: "Apple", TAGS.Model: "iPhone X"}
    lenses = set()
    for number, film in enumerate((28, 28, 36)):
        own = {TAGS.FocalLength: 4.0, TAGS.FocalLengthIn35mmFilm: film, TAGS.LensModel: "back 4mm"}
        file = taken(tmp_path / f"{number}.jpg", pixels, base=base, own=own)
        lenses.add(photograph(file, "a").lens)
    assert lenses == {
        "Apple, iPhone X, back 4mm, 4 mm, 28 mm of 35",
        "Apple, iPhone X, back 4mm, 4 mm, 36 mm of 35",
    }
    assert photograph(taken(tmp_path / "b.png", pixels), "b").lens == ""


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_a_photograph_is_upright_as_pillow_has_it(tmp_path, pixels, orientation, suffix):
    image, file = Image.fromarray(pixels), tmp_path / f"a{suffix}"
    image.getexif()[TAGS.Orientation] = orientation
    image.save(file, exif=image.getexif())
    shown = np.asarray(ImageOps.exif_transpose(image))
    found = photograph(file, "a")
    assert found.image.shape == shown.shape == (found.height, found.width, 3)
    assert np.abs(found.image.astype(int) - shown).max() < 30


def test_a_large_one_is_shrunk_and_keeps_places(tmp_path):
    # Not a multiple of what JPEG is decoded at: an edge at .4 of the width stays there.
    pixels = np.full((2003, 5005, 3), 40, np.uint8)
    pixels[:, :2002] = 220
    found = photograph(taken(tmp_path / "a.jpg", pixels), "a")
    assert found.image.shape == (480, 1200, 3) and (found.width, found.height) == (5005, 2003)
    row = found.image[240, :, 0].astype(float)
    assert ((row - 40) / 180).sum() == pytest.approx(480, abs=0.15)


@pytest.mark.filterwarnings("ignore::UserWarning")  # Pillow's, of what it skips
def test_nonsense_in_the_header_says_nothing(tmp_path, pixels):
    own = {TAGS.FocalLengthIn35mmFilm: 26, TAGS.LensModel: "x"}
    data = bytearray(taken(tmp_path / "a.jpg", pixels, 6, {TAGS.Make: "A"}, own).read_bytes())
    start = data.index(b"Exif")
    end = start - 2 + int.from_bytes(data[start - 2 : start], "big")
    rng = np.random.default_rng(0)
    for _ in range(60):
        bad = data.copy()
        for at in rng.integers(start + 14, end, 8):
            bad[at] = rng.integers(0, 256)
        (tmp_path / "b.jpg").write_bytes(bad)
        found = photograph(tmp_path / "b.jpg", "b")
        assert {found.width, found.height} == {400, 300}
        assert found.focal is None or 120 < found.focal < 8000
