"""The tracker ``sam2-video`` on networks with random weights: they run, and track nothing."""

from pathlib import Path

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


def save_sam2_video(folder: Path) -> Path:
    torch.manual_seed(0)
    parts = sam2_config()
    # Its memory has 64 channels, whatever the configuration says, and must be narrower than this.
    parts["vision_config"]["fpn_hidden_size"] = 128
    parts["prompt_encoder_config"]["hidden_size"] = 128
    parts["mask_decoder_config"]["hidden_size"] = 128
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
    bias = dict(model.named_parameters())["mask_decoder.pred_obj_score_head.proj_out.bias"]
    bias.data.fill_(3.0)  # objects are there, or all masks would be empty
    model.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return save_sam2_video(tmp_path_factory.mktemp("models") / "sam2-video")


def labels():
    """Objects, some with ids beyond 8 and 16 bits, one of one pixel."""
    drawn = np.zeros(SIZE, np.int32)
    drawn[20:60, 20:70] = 5
    drawn[60:100, 90:140] = 300
    drawn[0:15] = 70_000
    drawn[110, 10] = 9
    return drawn


def test_propagate_returns_known_ids_for_any_batch(folder):
    answers = []
    for batch in (1, 3, 16):
        tracker = load_tracker("sam2-video", model=folder, batch=batch, device="cpu")
        tracker.add(view(canvas()), labels())
        answers.append(tracker.propagate(view(canvas(seed=2))))
    assert answers[0].dtype == np.int32 and answers[0].shape == SIZE
    result = set(np.unique(answers[0]))
    assert result <= {0, *np.unique(labels())} and len(result) >= 3
    np.testing.assert_array_equal(answers[0], answers[1])
    np.testing.assert_array_equal(answers[0], answers[2])


def test_objects_are_tracked_from_all_frames_that_show_them(folder):
    tracker = Sam2Video(model=folder, device="cpu")
    tracker.add(view(canvas()), labels())
    first = tracker.propagate(view(canvas(seed=2)))
    np.testing.assert_array_equal(tracker.propagate(view(canvas(seed=2))), first)
    later = np.where(labels() == 5, 0, labels())
    later[70:90, 10:40] = 71_000
    tracker.add(view(canvas(seed=2)), later)
    # 5 was in the first frame only, 71000 in the second, the others in both.
    assert tracker._groups() == {(0, 1): [9, 300, 70_000], (0,): [5], (1,): [71_000]}
    carried = tracker.propagate(view(canvas(seed=3)))
    assert set(np.unique(carried)) <= {0, *np.unique(labels()), 71_000}


def test_pixel_takes_largest_positive_logit_and_lowest_id_of_equals(folder):
    class Fixed(Sam2Video):
        def _track(self, features):
            grid = torch.full((4, 4), -1.0)
            high, low = grid.clone(), grid.clone()
            high[:2], low[:2, :2] = 2.0, 1.0
            return {70_000: high, 8: low, 3: torch.zeros(4, 4), 400: high.clone()}

    tracker = Fixed(model=folder, device="cpu")
    result = tracker.propagate(view(canvas()))
    assert (result[:50] == 400).all() and not result[75:].any()


def test_associate_computes_one_copy_and_equals_all_copies(folder):
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
    every = associate(views, Regions(), Counted(model=folder, device="cpu"), 5, "copies")
    assert calls[3:] == ["a"] * 4 + ["b"] * 5
    np.testing.assert_array_equal(every.labels, maps.labels)
    np.testing.assert_array_equal(every.margin, maps.margin)
    assert (maps.margin < 1).any()  # its copies differ from the detection


def test_unusable_model_or_batch_is_refused_in_one_sentence(folder, tmp_path):
    images = save_sam2(tmp_path / "sam2")
    for inputs, says in [
        ({"model": folder, "batch": 0}, "sam2-video batch: found 0"),
        ({}, "sam2-video model: none given"),
        ({"model": images}, "is of type 'sam2', but sam2-video needs 'sam2_video'"),
    ]:
        with pytest.raises(InputError, match=says):
            Sam2Video(**inputs)
