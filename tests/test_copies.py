"""Recognition of copies of a photograph by their content, among real photographs."""

import io
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image, ImageOps

from slgaussian.copies import Thumbnail, are_copies


def jpeg(image: Image.Image, quality: int) -> Image.Image:
    data = io.BytesIO()
    image.save(data, "JPEG", quality=quality)
    return Image.open(data).convert("RGB")


def scale(image: Image.Image, divisor: int) -> Image.Image:
    return image.resize((image.width // divisor, image.height // divisor), Image.Resampling.BOX)


def with_status_bar(image: Image.Image) -> Image.Image:
    pixels = np.array(image)
    pixels[: len(pixels) // 25] = (20, 20, 200)
    return Image.fromarray(pixels)


def with_moved_thing(image: Image.Image) -> Image.Image:
    """Turn a window of a seventh of the width, as a thing that somebody touched."""
    side, copy = image.width // 7, image.copy()
    place = image.width // 3, image.height // 3
    window = copy.crop((*place, place[0] + side, place[1] + side))
    copy.paste(ImageOps.mirror(window).rotate(90), place)
    return copy


COPIES = {
    "JPEG of quality 30": lambda image: jpeg(image, 30),
    "one level brighter": lambda image: image.point(lambda level: level + 1),
    "less contrast, JPEG": lambda image: jpeg(image.point(lambda level: 0.8 * level + 15), 75),
    "gamma of 0.8": lambda image: image.point(lambda level: 255 * (level / 255) ** 0.8),
    "grey": lambda image: image.convert("L").convert("RGB"),
    "half the size, JPEG": lambda image: jpeg(scale(image, 2), 60),
    "an eighth of the size": lambda image: scale(image, 8),
    "cropped by four percent": lambda image: ImageOps.crop(image, (image.width // 50, 9, 7, 5)),
    "white frame": lambda image: ImageOps.expand(image, image.width // 40, "white"),
    "status bar": with_status_bar,
    "turned by a quarter": lambda image: image.transpose(Image.Transpose.ROTATE_90),
    "mirrored": ImageOps.mirror,
}


def thumbnail(image: Image.Image) -> Thumbnail:
    return Thumbnail.of(np.asarray(image.convert("RGB")))


@pytest.fixture(scope="module")
def photographs(real_data) -> list[Image.Image]:
    names = (
        "office_walk/images/00171.jpg",
        "places/kitchen/images/14.jpg",
        "things/can/images/0006.jpg",
    )
    return [Image.open(real_data / name).convert("RGB") for name in names]


@pytest.mark.parametrize("change", COPIES)
def test_copies_are_recognised(photographs, change):
    for image in photographs:
        a, b = thumbnail(image), thumbnail(COPIES[change](image))
        assert are_copies(a, b) and are_copies(b, a)


def test_photographs_of_one_thing_are_no_copies(real_data, photographs):
    walk = sorted((real_data / "office_walk/images").iterdir())[:60]
    pictures = [thumbnail(Image.open(file)) for file in walk]
    pairs = list(pairwise(pictures))
    still = [real_data / "strangers/tkitchen" / name for name in ("0000.jpg", "0002.jpg")]
    pairs.append(tuple(thumbnail(Image.open(file)) for file in still))
    pairs += [(thumbnail(image), thumbnail(with_moved_thing(image))) for image in photographs]
    assert [number for number, pair in enumerate(pairs) if are_copies(*pair)] == []


def test_pictures_without_detail_are_no_copies():
    ramp = np.add.outer(np.arange(240) / 8, np.arange(320) / 8)[..., None].repeat(3, 2)
    blank, brighter = (np.full((240, 320, 3), grey, np.uint8) for grey in (90, 91))
    assert not are_copies(Thumbnail.of(blank), Thumbnail.of(blank))
    assert not are_copies(Thumbnail.of(blank), Thumbnail.of(brighter))
    first, second = (Thumbnail.of((ramp + offset).astype(np.uint8)) for offset in (0, 9))
    assert are_copies(first, first) and not are_copies(first, second)


def test_views_of_a_wall_beside_each_other_are_no_copies(photographs):
    wall = np.asarray(photographs[0])
    width = wall.shape[1] - 24
    assert not are_copies(Thumbnail.of(wall[:, :width]), Thumbnail.of(wall[:, 24:]))
