"""Masks in the formats that programs write."""

import numpy as np
import pytest
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.formats.images import read_mask

SET = np.zeros((20, 30), bool)
SET[5:12, 8:21] = True


def levels(high, low=0, dtype=np.uint8) -> np.ndarray:
    return np.where(SET, high, low).astype(dtype)


def layers(*channels) -> np.ndarray:
    return np.stack([np.broadcast_to(c, SET.shape) for c in channels], -1).astype(np.uint8)


def palette(transparent: bool) -> Image.Image:
    image = Image.fromarray(levels(1), mode="P")
    image.putpalette([255] * 6 if transparent else [0, 0, 0, 255, 255, 255])
    if transparent:
        image.info["transparency"] = 0
    return image


COLOURS = np.random.default_rng(0).integers(0, 256, (20, 30))
ALPHA = levels(255)
MARGIN = np.full(SET.shape, 255)
MARGIN[:, :2] = 0
"""Alpha of a frame whose first columns nobody drew."""

IMAGES = {
    "L": Image.fromarray(levels(255)),
    "1": Image.fromarray(SET),
    "P": palette(False),
    "P, a transparent colour": palette(True),
    "I;16": Image.fromarray(levels(65535, dtype=np.uint16)),
    "RGB": Image.fromarray(layers(*[levels(255)] * 3)),
    "RGBA, opaque": Image.fromarray(layers(*[levels(255)] * 3, 255)),
    "RGBA, white": Image.fromarray(layers(255, 255, 255, ALPHA)),
    "RGBA, black": Image.fromarray(layers(0, 0, 0, ALPHA)),
    "RGBA, a photograph cut out": Image.fromarray(layers(*[COLOURS] * 3, ALPHA)),
    "RGBA, black and white with a margin": Image.fromarray(layers(*[levels(255)] * 3, MARGIN)),
    "LA, white": Image.fromarray(layers(255, ALPHA)),
}


@pytest.mark.parametrize("least", [128, 255])
@pytest.mark.parametrize("kind", IMAGES)
def test_a_mask_is_read_from_whatever_carries_it(tmp_path, kind, least):
    IMAGES[kind].save(tmp_path / "m.png")
    assert np.array_equal(read_mask(tmp_path / "m.png", least), SET)


@pytest.mark.parametrize("colour", [0, 255])
def test_a_mask_that_is_transparent_everywhere_is_empty(tmp_path, colour):
    Image.fromarray(layers(colour, colour, colour, 0)).save(tmp_path / "m.png")
    assert not read_mask(tmp_path / "m.png").any()


def test_dark_levels_are_refused_and_not_taken_for_nothing(tmp_path):
    Image.fromarray(levels(1)).save(tmp_path / "m.png")
    with pytest.raises(InputError, match=r"m\.png: its brightest pixel is 1, expected 255 where"):
        read_mask(tmp_path / "m.png")
    Image.fromarray(levels(0.5, dtype=np.float32)).save(tmp_path / "m.tiff")
    with pytest.raises(InputError, match=r"m\.tiff: cannot be read \(floating-point pixels\)"):
        read_mask(tmp_path / "m.tiff")
