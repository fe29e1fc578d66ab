"""Masks in the formats that programs write."""

import cv2
import numpy as np
import pytest
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.formats.images import mask_levels, read_mask

SET = np.zeros((20, 30), bool)
SET[5:12, 8:21] = True


def levels(high, low=0, dtype=np.uint8) -> np.ndarray:
    return np.where(SET, high, low).astype(dtype)


def layers(*channels) -> np.ndarray:
    return np.stack([np.broadcast_to(c, SET.shape) for c in channels], -1).astype(np.uint8)


def palette(transparent: bool, inside: tuple[int, ...] = (255, 255, 255)) -> Image.Image:
    image = Image.fromarray(levels(1), mode="P")
    image.putpalette([255] * 6 if transparent else [0, 0, 0, *inside])
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
    "P, dark red": palette(False, (128, 0, 0)),
    "L, 0 and 1": Image.fromarray(levels(1)),
    "I;16, 0 and 1": Image.fromarray(levels(1, dtype=np.uint16)),
    "I;16, 0 and 255": Image.fromarray(levels(255, dtype=np.uint16)),
    "I;16, 1 of 8 bits": Image.fromarray(levels(257, dtype=np.uint16)),
    "I;16, shifted": Image.fromarray(levels(65280, dtype=np.uint16)),
    "I, 0 and 1": Image.fromarray(levels(1, dtype=np.int32)),
    "F, 0 and 1": Image.fromarray(levels(1, dtype=np.float32)),
    "F, 0 and 255": Image.fromarray(levels(255, dtype=np.float32)),
    "RGB, red": Image.fromarray(layers(levels(255), 0, 0)),
    "RGB, 0 and 1": Image.fromarray(layers(*[levels(1)] * 3)),
    "RGBA, alpha of 0 and 1": Image.fromarray(layers(255, 255, 255, levels(1))),
    "RGBA, 0 and 1 with a margin": Image.fromarray(layers(*[levels(1)] * 3, MARGIN)),
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
def test_read_mask_accepts_every_mode_and_range(tmp_path, kind, least):
    file = tmp_path / f"m.{'tiff' if kind.startswith(('F', 'I,')) else 'png'}"
    IMAGES[kind].save(file)
    assert np.array_equal(read_mask(file, least), SET)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_soft_edges_keep_their_levels_in_8_and_16_bits(tmp_path, dtype):
    soft = np.linspace(0, 255, SET.size).astype(dtype).reshape(SET.shape)
    for scale in (1, 257) if dtype == np.uint16 else (1,):
        Image.fromarray(soft * dtype(scale)).save(tmp_path / "m.png")
        assert np.array_equal(mask_levels(tmp_path / "m.png"), soft)


@pytest.mark.parametrize(
    "empty",
    [layers(0, 0, 0, 0), layers(255, 255, 255, 0), levels(0, dtype=np.uint16), levels(0)],
)
def test_read_mask_warns_about_an_empty_mask(tmp_path, empty):
    Image.fromarray(empty).save(tmp_path / "m.png")
    with pytest.warns(UserWarning, match=r"m\.png: the mask is empty, all of its pixels are 0"):
        assert not read_mask(tmp_path / "m.png").any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            levels(2),
            "has values from 0 to 2, which are not clear.; save the mask as a grey PNG, 0 out",
        ),
        (levels(100, 3), "values from 3 to 100"),
        (levels(7, dtype=np.uint16), "values from 0 to 7"),
        (np.arange(600, dtype=np.uint16).reshape(SET.shape), "values from 0 to 599"),
        (levels(4095, dtype=np.uint16), "values from 0 to 4095"),
        (levels(1, -1, np.int32), "values from -1 to 1"),
        (levels(0.5, dtype=np.float32), "values from 0 to 0.5"),
        (levels(np.nan, dtype=np.float32), "values from nan to nan"),
    ],
)
def test_read_mask_refuses_values_of_unclear_range(tmp_path, values, message):
    Image.fromarray(values).save(tmp_path / "m.tiff")
    with pytest.raises(InputError, match=rf"m\.tiff: cannot be read \(.*{message}"):
        read_mask(tmp_path / "m.tiff")


def test_read_mask_refuses_low_levels_and_colours_of_16_bits(tmp_path):
    Image.fromarray(levels(200)).save(tmp_path / "m.png")
    with pytest.raises(InputError, match=r"m\.png: its brightest pixel is 200, expected 255 where"):
        read_mask(tmp_path / "m.png", 255)
    cv2.imwrite(str(tmp_path / "m.png"), np.repeat(levels(255, dtype=np.uint16)[..., None], 3, -1))
    with pytest.raises(InputError, match=r"colours of 16 bits that are all below 256"):
        read_mask(tmp_path / "m.png")
