"""The tracker ``sam2-video`` on networks with random weights, which track nothing."""

import numpy as np
import pytest
import torch
import transformers
from drawn_views import SIZE, canvas, paste, view
from small_models import SIDE, draw_weights, sam2_config, save_sam2

from slgaussian.errors import InputError
from slgaussian.masks import load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.regions import Regions
from slgaussian.masks.sam2_video import Sam2Video

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    torch.manual_seed(0)
    parts = sam2_config()
    # The memory has 64 channels whatever the configuration says, and must be narrower than this.
    parts["vision_config"]["fpn_hidden_size"] = 128
    for part in ("prompt_encoder_config", "mask_decoder_config"):
        parts[part]["hidden_size"] = 128
    config = transformers.Sam2VideoConfig(
        **parts,
        image_size=SIDE,
        memory_attention_hidden_size=128,
        memory_attention_num_layers=1,
        memory_attention_feed_forward_hidden_size=32,
        memory_attention_rope_feat_sizes=[SIDE // 16, SIDE // 16],
        memory_encoder_hidden_size=128,
        memory_encoder_output_channels=64,
        mask_downsampler_embed_dim=128,
        memory_fuser_num_layers=1,
        memory_fuser_embed_dim=128,
        memory_fuser_intermediate_dim=32,
    )
    model = transformers.Sam2VideoModel(config)
    draw_weights(model)
    for name, tensor in model.named_parameters():
        if "pred_obj_score_head.proj_out.bias" in name:
            tensor.data.fill_(3.0)  # objects are present, or all masks would be empty
    folder = tmp_path_factory.mktemp("models") / "sam2-video"
    model.save_pretrained(folder)
    return folder


@pytest.fixture
def labels():
    """Objects, some with ids beyond 8 and 16 bits, one of one pixel."""
    labels = np.zeros(SIZE, np.int32)
    labels[20:60, 20:70] = 5
    labels[60:100, 90:140] = 300
    labels[0:15] = 70_000
    labels[110, 10] = 9
    return labels


def test_batch_size_does_not_change_the_carried_ids(folder, labels):
    results = []
    for batch in (1, 3, 16):
        tracker = load_tracker("sam2-video", model=folder, batch=batch, device="cpu")
        tracker.add(view(canvas()), labels)
        results.append(tracker.propagate(view(canvas(seed=2))))
    first, *larger = results
    assert first.dtype == np.int32 and first.shape == SIZE
    ids = set(np.unique(first))
    assert ids <= {0, *np.unique(labels)} and len(ids) >= 3
    for result in larger:
        np.testing.assert_array_equal(result, first)


def test_objects_are_grouped_by_their_frames_and_propagation_repeats(folder, labels):
    tracker = Sam2Video(model=folder, device="cpu")
    tracker.add(view(canvas()), labels)
    first = tracker.propagate(view(canvas(seed=2)))
    np.testing.assert_array_equal(tracker.propagate(view(canvas(seed=2))), first)
    later = np.where(labels == 5, 0, labels)
    later[70:90, 10:40] = 71_000
    tracker.add(view(canvas(seed=2)), later)
    # 5 was in the first frame only, 71000 in the second, the others in both.
    assert tracker._groups() == {(0, 1): [9, 300, 70_000], (0,): [5], (1,): [71_000]}
    carried = tracker.propagate(view(canvas(seed=3)))
    assert set(np.unique(carried)) <= {0, *np.unique(labels), 71_000}


def test_pixels_go_to_the_largest_positive_logit_and_ties_to_the_lowest_id(folder):
    class Fixed(Sam2Video):
        def _track(self, features):
            grid = torch.full((4, 4), -1.0)
            high, low = grid.clone(), grid.clone()
            high[:2], low[:2, :2] = 2.0, 1.0
            return {70_000: high, 8: low, 3: torch.zeros(4, 4), 400: high.clone()}

    tracker = Fixed(model=folder, device="cpu")
    result = tracker.propagate(view(canvas()))
    assert (result[:50] == 400).all() and not result[75:].any()


def test_association_with_copies(folder):
    picture = canvas((140, 140, 140))
    paste(picture, (20, 60, 20, 70), (200, 40, 40), 1)
    views = [view(picture), view(picture + 3, "b")]
    calls = []

    class Counted(Sam2Video):
        def propagate(self, observed):
            calls.append(observed.view.name)
            return super().propagate(observed)

    maps = associate(views, Regions(), Counted(model=folder, device="cpu"), replicas=5)
    # One copy of each view stands for the others; the second comes carried too.
    assert calls == ["a", "b", "b"]
    assert maps.labels.shape == (2, *SIZE) and (maps.margin >= 0.6 - 1e-6).all()
    complete = associate(views, Regions(), Counted(model=folder, device="cpu"), 5, "copies")
    assert calls[3:] == ["a"] * 4 + ["b"] * 5
    np.testing.assert_array_equal(complete.labels, maps.labels)
    np.testing.assert_array_equal(complete.margin, maps.margin)
    assert (maps.margin < 1).any()  # its copies differ from the detection


def test_unusable_settings_are_refused(folder, tmp_path):
    images = save_sam2(tmp_path / "sam2")
    for settings, message in [
        ({"model": folder, "batch": 0}, "sam2-video batch: found 0"),
        ({}, "sam2-video model: none given"),
        ({"model": tmp_path / "missing"}, "there is no such folder"),
        ({"model": images}, "is of type 'sam2', but sam2-video needs 'sam2_video'"),
    ]:
        with pytest.raises(InputError, match=message):
            Sam2Video(**settings)
