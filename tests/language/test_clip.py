"""CLIP with random weights: inputs and outputs are checked, not their meaning."""

import json
import shutil
import sys

import numpy as np
import pytest
import torch
import transformers
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from small_clip import SIDE, WIDTH, clip_model, save_clip, save_tokenizer

from slgaussian.errors import InputError
from slgaussian.language import load_encoder
from slgaussian.language.clip import MEAN, STD, region_crop

# Between float32 and float64, the largest difference in any unit vector here is 4e-7.
NOISE = 1e-6


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return save_clip(tmp_path_factory.mktemp("clip") / "model")


@pytest.fixture(scope="module")
def clip(folder):
    return load_encoder("clip", model=folder)


@pytest.fixture(scope="module")
def in_float64(folder):
    return transformers.CLIPModel.from_pretrained(folder, local_files_only=True).double().eval()


def picture(height=60, width=80, seed=0):
    coarse = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), np.uint8)
    return np.ascontiguousarray(coarse.repeat(-(-height // 6), 0).repeat(-(-width // 8), 1))[
        :height, :width
    ].copy()


def regions(count=6, height=60, width=80):
    """Discs and half discs, overlapping, some cut off by an edge."""
    y, x = np.mgrid[:height, :width]
    masks = [
        ((x - 11 * i - 5) ** 2 + (y - 7 * i - 12) ** 2 < (6 + 2 * i) ** 2)
        & ((i % 2 == 0) | (y % 3 > 0))
        for i in range(count)
    ]
    return np.array(masks)


def expected_crop(image, mask):
    """Build the crop with its margins and black background, pixel by pixel."""
    rows, columns = np.nonzero(mask)
    top, left = rows.min(), columns.min()
    height, width = rows.max() - top + 1, columns.max() - left + 1
    side = max(height, width)
    square = np.zeros((side, side, 3), np.uint8)
    for row, column in zip(rows, columns, strict=True):
        down, right = (side - height) // 2, (side - width) // 2
        square[row - top + down, column - left + right] = image[row, column]
    return square


@pytest.mark.parametrize("i", [0, 5])
def test_region_crop_pads_to_a_black_square(i):
    image, mask = picture(), regions()[i]
    expected = expected_crop(image, mask)
    actual = region_crop(image, mask, len(expected), context=False)
    assert np.array_equal(actual, expected)
    # Scaled to the double, every pixel lies between four, a quarter and three quarters from them.
    double = region_crop(image, mask, 2 * len(expected), context=False).astype(float)
    near = expected.astype(float)
    mixed = (9 * near[:-1, :-1] + 3 * near[1:, :-1] + 3 * near[:-1, 1:] + near[1:, 1:]) / 16
    assert np.abs(double[1:-1:2, 1:-1:2] - mixed).max() <= 1


def reference_regions(network, image, masks, context=False):
    vectors = []
    for mask in masks:
        pixels = region_crop(image, mask, SIDE, context).astype(np.float64) / 255
        pixels = torch.from_numpy(((pixels - MEAN) / STD).transpose(2, 0, 1)[None].copy())
        with torch.no_grad():
            vectors.append(network.get_image_features(pixels).pooler_output[0].numpy())
    vectors = np.array(vectors)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_encode_regions_equals_transformers_in_float64(folder, clip, in_float64):
    image, masks = picture(), regions()
    actual = clip.encode_regions(image, masks)
    assert actual.dtype == np.float32 and actual.shape == (6, WIDTH)
    expected = reference_regions(in_float64, image, masks)
    assert np.abs(actual - expected).max() < NOISE
    assert (actual @ actual.T).min() < 0.9  # not all alike
    # With context, the mean of two pictures.
    actual = load_encoder("clip", model=folder, crops="context").encode_regions(image, masks)
    both = expected + reference_regions(in_float64, image, masks, context=True)
    assert np.abs(actual - both / np.linalg.norm(both, axis=1, keepdims=True)).max() < NOISE
    assert np.abs(actual - expected).max() > 0.01
    # The temperature with which CLIP begins; the published ones end at 0.01.
    assert clip.soft == pytest.approx(0.07, abs=0.001)


TEXTS = ["red basket", "Red  BASKET", "things", "Pokémon 球 🎈", "it's 23.5% wool!"]


def test_encode_text_equals_transformers_in_float64(clip, in_float64, folder):
    words = transformers.CLIPTokenizer.from_pretrained(folder, local_files_only=True)
    actual = clip.encode_text(TEXTS)
    assert actual.dtype == np.float32 and actual.shape == (5, WIDTH)
    # Padded to the full length with the token that ends texts, and with 0 as open_clip does.
    for pad in (words.eos_token_id, 0):
        ids = np.full((5, 77), pad)
        for row, text in zip(ids, TEXTS, strict=True):
            tokens = words(text)["input_ids"]
            row[: len(tokens)] = tokens
        with torch.no_grad():
            expected = in_float64.get_text_features(torch.from_numpy(ids)).pooler_output.numpy()
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        assert np.abs(actual - expected).max() < NOISE
    assert np.array_equal(actual[0], actual[1])  # case and spaces do not matter
    assert (actual[1:] @ actual[1:].T).min() < 0.9


def test_encoding_does_not_depend_on_other_regions_and_texts(clip):
    image, masks = picture(), regions()
    actual = clip.encode_regions(image, masks)
    assert np.array_equal(clip.encode_regions(image, masks[::-1])[::-1], actual)
    assert np.array_equal(clip.encode_regions(image, masks[4:5]), actual[4:5])
    texts = clip.encode_text(TEXTS)
    assert np.array_equal(clip.encode_text(TEXTS[::-1])[::-1], texts)
    assert np.array_equal(clip.encode_text(TEXTS[2:3]), texts[2:3])


@pytest.mark.parametrize(
    ("settings", "least", "most"),
    [
        ({"batch": 1}, -1, NOISE),
        ({"batch": 64}, -1, NOISE),
        ({"precision": "bfloat16"}, 1e-5, 0.03),  # 8 bits in each of a few dozen sums
    ],
)
def test_batch_and_precision_change_rounding_only(folder, clip, settings, least, most):
    other = load_encoder("clip", model=folder, **settings)
    assert other.network is clip.network  # loaded once
    actual, fine = (encoder.encode_regions(picture(), regions()) for encoder in (other, clip))
    assert least < np.abs(actual - fine).max() < most
    assert np.array_equal(other.encode_text(TEXTS), clip.encode_text(TEXTS))


@hypothesis_settings(max_examples=60, deadline=None)
@given(text=st.text(max_size=40))
def test_encode_text_gives_a_unit_vector_or_one_line_error(clip, text):
    try:
        actual = clip.encode_text([text])
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert abs(np.linalg.norm(actual) - 1) < NOISE


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty; describe an object"),
        ("word " * 76, "tokens, but the model reads at most 77; say it in fewer words"),
        ("a" * 5000, "has 5002 tokens, but the model reads at most 77"),
        ("\ud800", "is not valid text"),
    ],
)
def test_encode_text_raises_input_error_for_unreadable_texts(clip, text, says):
    with pytest.raises(InputError, match=says) as error:
        clip.encode_text(["red", text])
    assert "\n" not in str(error.value) and len(str(error.value)) < 250


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"crops": "square"}, "clip crops: found 'square', expected one of masked, context"),
        ({"batch": 0}, "clip batch: found 0, expected a whole number from 1"),
        ({"device": "tpu"}, "clip device 'tpu': cannot be used"),
        ({"model": None}, "clip model: found None, expected a path or a name"),
        ({"model": "no/such/folder"}, "there is no such folder"),
        ({"tokenizer": __file__}, "tokenizer .*: there is no such folder"),
    ],
)
def test_invalid_settings_raise_one_sentence(folder, settings, says):
    with pytest.raises(InputError, match=says) as error:
        load_encoder("clip", **{"model": folder, **settings})
    assert "\n" not in str(error.value)


def test_model_of_another_type_raises_input_error(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "model")
    config = tmp_path / "model" / "config.json"
    config.write_text(json.dumps({**json.loads(config.read_text()), "model_type": "siglip"}))
    with pytest.raises(InputError, match="is of type 'siglip', but clip needs 'clip'"):
        load_encoder("clip", model=tmp_path / "model")


def test_tokenizer_is_read_beside_the_model_or_from_its_setting(folder, clip, tmp_path):
    alone = shutil.copytree(folder, tmp_path / "model")
    for name in ("vocab.json", "merges.txt"):
        (alone / name).unlink()
    with pytest.raises(InputError, match=r"no tokenizer beside it.*--set clip.tokenizer") as error:
        load_encoder("clip", model=alone)
    assert "\n" not in str(error.value)
    save_tokenizer(tmp_path / "words")
    named = load_encoder("clip", model=alone, tokenizer=tmp_path / "words")
    assert np.array_equal(named.encode_text(TEXTS), clip.encode_text(TEXTS))
    with pytest.raises(InputError, match=r"tokenizer .* holds none; expected tokenizer\.json"):
        load_encoder("clip", model=alone, tokenizer=alone)
    # One file may hold it.
    words = transformers.CLIPTokenizer.from_pretrained(folder, local_files_only=True)
    words.save_pretrained(alone)
    assert (alone / "tokenizer.json").is_file() and not (alone / "merges.txt").exists()
    actual = load_encoder("clip", model=alone).encode_text(TEXTS)
    assert np.array_equal(actual, clip.encode_text(TEXTS))
    clip_model(400).save_pretrained(tmp_path / "other")
    with pytest.raises(InputError, match="give the tokenizer of this model"):
        load_encoder("clip", model=tmp_path / "other", tokenizer=folder)


def test_normalisation_follows_the_preprocessor_file(folder, clip, tmp_path):
    """LAION's ViT-L/14 of laion2B-s32B is one that was trained with other constants than CLIP's."""
    shutil.copytree(folder, tmp_path / "model")
    file = tmp_path / "model" / "preprocessor_config.json"
    file.write_text(json.dumps({"image_mean": [0.5] * 3, "image_std": [0.5] * 3}))
    other = load_encoder("clip", model=tmp_path / "model").encode_regions(picture(), regions())
    assert np.abs(other - clip.encode_regions(picture(), regions())).max() > 0.01
    file.write_text(json.dumps({"image_mean": [0, 1]}))
    with pytest.raises(InputError, match="expected three numbers each"):
        load_encoder("clip", model=tmp_path / "model")


def test_old_configuration_with_end_token_2_encodes_equally(folder, clip, tmp_path):
    shutil.copytree(folder, tmp_path / "model")
    config = json.loads((folder / "config.json").read_text())
    config["text_config"]["eos_token_id"] = 2
    (tmp_path / "model" / "config.json").write_text(json.dumps(config))
    actual = load_encoder("clip", model=tmp_path / "model").encode_text(TEXTS)
    assert np.array_equal(actual, clip.encode_text(TEXTS))


def test_load_encoder_finds_a_hub_name_in_the_cache(folder, clip, tmp_path, monkeypatch):
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(InputError, match=r"laion/CLIP-ViT-B-16.* does not hold it \(\w+: "):
        load_encoder("clip")
    place = tmp_path / "models--laion--CLIP-ViT-B-16-laion2B-s34B-b88K"
    (place / "refs").mkdir(parents=True)
    (place / "refs" / "main").write_text("0" * 40)
    shutil.copytree(folder, place / "snapshots" / ("0" * 40))
    assert np.array_equal(load_encoder("clip").encode_text(TEXTS), clip.encode_text(TEXTS))


def test_missing_transformers_raises_input_error_with_the_extra(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(
        InputError, match=r"clip: needs the package transformers.*`pip install 'transformers"
    ):
        load_encoder("clip", model=folder)
