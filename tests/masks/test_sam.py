"""SAM and SAM 2 with random weights: inputs and outputs are checked, not their meaning.

The models are made here and saved to a folder (``small_models``); nothing is downloaded.
"""

import shutil

import numpy as np
import pytest
import torch
import transformers
from safetensors.torch import load_file, save_file
from small_models import SIDE, save_sam, save_sam2

from slgaussian.components.pretrained import model_digest
from slgaussian.errors import InputError
from slgaussian.geometry import SeenView
from slgaussian.masks import load_proposer
from slgaussian.masks.configs import Automatic
from slgaussian.masks.sam import normalise, pixel_values

SAVE = {"sam": save_sam, "sam2": save_sam2}
LENIENT = Automatic(points=5, predicted_iou=0.2, stability=0.6, box_iou=0.9)


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return {name: save(tmp_path_factory.mktemp(name)) for name, save in SAVE.items()}


def seen_view():
    return SeenView.alone(picture())


def picture(size=(60, 80), seed=0):
    coarse = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), np.uint8)
    large = coarse.repeat(-(-size[0] // 6), 0).repeat(-(-size[1] // 8), 1)
    return large[: size[0], : size[1]].copy()


def pillow_processor():
    return transformers.models.sam.image_processing_pil_sam.SamImageProcessorPil(
        size={"longest_edge": SIDE}, pad_size={"height": SIDE, "width": SIDE}
    )


@pytest.mark.parametrize("size", [(60, 80), (41, 97), (300, 200), (64, 64), (7, 500), (1, 1)])
def test_pixel_values_equal_processor_of_transformers(size):
    image = picture(size)
    processor = pillow_processor()
    expected = processor(image, return_tensors="pt", input_data_format="channels_last")
    result, used = pixel_values(image, SIDE)
    assert used == tuple(expected["reshaped_input_sizes"][0].tolist())
    # Both resize in Pillow's integers; the rest is float32 rounding of values up to 2.7.
    torch.testing.assert_close(result, expected["pixel_values"], rtol=0, atol=1e-6)


def test_sam_masks_equal_those_of_transformers(folders):
    image, points = picture((48, 80)), [[10, 12], [70, 40], [33, 5]]
    proposer = load_proposer("sam", model=folders["sam"])
    processor = transformers.SamProcessor(pillow_processor())
    inputs = processor(image, input_points=[[[p] for p in points]], return_tensors="pt")
    sizes = inputs.pop("original_sizes"), inputs.pop("reshaped_input_sizes")
    network = transformers.SamModel.from_pretrained(folders["sam"])
    with torch.no_grad():
        expected = network(**{k: v.to(torch.float32) for k, v in inputs.items()})
        prompted = proposer.encode(image)
        logits, predicted = prompted.segment(np.array(points, float))
        large = prompted.enlarge(logits.flatten(0, 1))
    # The same layers on the same numbers, but points scaled in another order: 1e-6 of the logits,
    # which reach 300 here.
    torch.testing.assert_close(logits, expected.pred_masks[0], rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(predicted, expected.iou_scores[0], rtol=1e-4, atol=1e-5)
    masks = processor.image_processor.post_process_masks(
        expected.pred_masks, *sizes, binarize=False, pad_size={"height": SIDE, "width": SIDE}
    )
    torch.testing.assert_close(large, masks[0].flatten(0, 1), rtol=1e-4, atol=1e-3)


def test_sam2_masks_equal_those_of_transformers(folders):
    image, points = picture((48, 80)), np.array([[10.0, 12], [70, 40], [33, 5]])
    proposer = load_proposer("sam2", model=folders["sam2"])
    network = transformers.Sam2Model.from_pretrained(folders["sam2"])
    scaled = torch.from_numpy(points * [SIDE / 80, SIDE / 48]).float()
    with torch.no_grad():
        expected = network(
            pixel_values=normalise(image, (SIDE, SIDE)), input_points=scaled[None, :, None]
        )
        prompted = proposer.encode(image)
        logits, predicted = prompted.segment(points)
        assert prompted.enlarge(logits.flatten(0, 1)).shape == (9, 48, 80)
    torch.testing.assert_close(logits, expected.pred_masks[0], rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(predicted, expected.iou_scores[0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", SAVE)
def test_model_is_loaded_once_for_the_same_content(folders, name, tmp_path):
    item, alternative = (
        load_proposer(name, model=folders[name], preset=p) for p in ("sam", "sam2")
    )
    assert item.network is alternative.network
    changed = shutil.copytree(folders[name], tmp_path / "changed")
    weights = load_file(changed / "model.safetensors")
    save_file({key: value + 1 for key, value in weights.items()}, changed / "model.safetensors")
    assert load_proposer(name, model=changed).network is not item.network


@pytest.mark.parametrize("name", SAVE)
def test_image_is_encoded_once_for_consecutive_calls(folders, name, monkeypatch):
    proposer = load_proposer(name, model=folders[name], preset=LENIENT)
    mask = np.zeros((60, 80), bool)
    mask[:30] = True
    fresh = load_proposer(name, model=folders[name], preset=LENIENT).propose(seen_view(), mask)
    encoded = []
    encode = proposer.network.get_image_embeddings
    monkeypatch.setattr(
        proposer.network, "get_image_embeddings", lambda pixels: encoded.append(1) or encode(pixels)
    )
    for image in (picture(), picture(seed=1), picture()):
        proposer.propose(SeenView.alone(image))
        rerun = proposer.propose(SeenView.alone(image), mask)
    assert len(encoded) == 3
    assert rerun.masks.tobytes() == fresh.masks.tobytes()


@pytest.mark.parametrize("name", SAVE)
def test_proposer_obeys_level_region_points_and_presets(folders, name):
    def propose(mask=None, **settings):
        return load_proposer(name, model=folders[name], **settings).propose(seen_view(), mask)

    parts, groups = (propose(preset=LENIENT, level=level).masks for level in ("s", "l"))
    assert len(parts) and parts.tobytes() != groups.tobytes()
    assert len(propose(np.zeros((60, 80), bool)).masks) == 0
    assert len(propose(points=1).masks) <= 3
    for preset in ("sam", "sam2", "grouping"):
        result = propose(preset=preset, points=2)
        assert result.masks.dtype == bool and result.masks.any((1, 2)).all()


@pytest.mark.parametrize(
    ("name", "settings", "says"),
    [
        ("sam", {}, "sam model: none given; .* --set sam.model=facebook/sam-vit-base"),
        ("sam", {"model": "sam2"}, "is of type 'sam2', but sam needs 'sam', such as facebook"),
        ("sam", {"model": "no/such/folder"}, "there is no such folder; expected one with config"),
        ("sam", {"model": __file__}, "is a file, or of open_clip; sam expected"),
        ("sam", {"model": "sam", "preset": "dino"}, "found 'dino', expected one of sam, sam2, gro"),
        ("sam", {"model": "sam", "device": "tpu"}, "sam device 'tpu': cannot be used"),
    ],
)
def test_unusable_model_or_setting_is_refused_in_one_sentence(folders, name, settings, says):
    settings = {k: folders.get(v, v) if k == "model" else v for k, v in settings.items()}
    with pytest.raises(InputError, match=says):
        load_proposer(name, **settings)


def test_model_in_shards_equals_model_in_one_file(folders, tmp_path):
    network = transformers.SamModel.from_pretrained(folders["sam"])
    network.save_pretrained(tmp_path, max_shard_size="60KB")
    assert len(list(tmp_path.glob("model-*.safetensors"))) > 1
    result, expected = (
        load_proposer("sam", model=f, preset=LENIENT).propose(seen_view())
        for f in (tmp_path, folders["sam"])
    )
    assert result.masks.tobytes() == expected.masks.tobytes()
    next(tmp_path.glob("model-*.safetensors")).unlink()
    with pytest.raises(InputError, match="has no model-0"):
        model_digest(tmp_path)
