"""Round trips of objects through the store."""

import uuid
from dataclasses import replace

import numpy as np
import pytest

from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.evaluate import SceneResult, truth_from_instances
from slgaussian.errors import InputError
from slgaussian.scene import Estimated
from slgaussian.storage.store import ArtifactStore
from tasks.artifacts import (
    decode_pictures,
    decode_pngs,
    decode_predictions,
    result_from_arrays,
    result_to_arrays,
    sample_from_arrays,
    sample_to_arrays,
    truth_from_arrays,
    truth_to_arrays,
)


@pytest.fixture(scope="module")
def sample():
    scene = datasets.load("procedural", seed=3, objects=2, views=3, height=32, width=48)
    return scene.sample(["view_00", "view_02"], ["view_01"])


@pytest.fixture
def store():
    return ArtifactStore(f"memory://{uuid.uuid4().hex}")


def through(store, spec, arrays):
    return store.get(store.put(spec, arrays))


def test_a_sample_with_all_its_truths(sample, store):
    back = sample_from_arrays(through(store, "sample", sample_to_arrays(sample)))
    assert (back.scene, dict(back.phrases)) == (sample.scene, dict(sample.phrases))
    assert len(back.context) == 2
    for old, new in zip(
        (*sample.context, *sample.targets), (*back.context, *back.targets), strict=True
    ):
        assert new.name == old.name
        for name in ("image", "depth", "instances"):
            assert getattr(new, name).dtype == getattr(old, name).dtype
            np.testing.assert_array_equal(getattr(new, name), getattr(old, name))
        np.testing.assert_array_equal(new.camera.K, old.camera.K)
        np.testing.assert_array_equal(new.camera.c2w, old.camera.c2w)
        assert (new.camera.near, new.camera.far) == (old.camera.near, old.camera.far)


def test_cameras_that_were_found_say_so_in_the_store_too(sample, store):
    message = Estimated((0.9, 1.2), "EXIF", 0.8)
    left, right = sample.context
    camera = replace(left.camera, estimated=message)
    partly = replace(
        sample, context=(replace(left, camera=camera), right), estimation={"k1": {"a": 0}}
    )
    back = sample_from_arrays(through(store, "sample", sample_to_arrays(partly)))
    assert [view.camera.estimated for view in back.context] == [message, None]
    assert back.estimation == {"k1": {"a": 0}}
    assert not {"estimated", "found"} & sample_to_arrays(sample).keys()


def test_a_truth_that_only_some_views_have_stays_theirs(sample, store):
    left, right = sample.context
    camera = replace(right.camera, near=0.5, far=9.0)
    bare = replace(right, depth=None, instances=None, camera=camera)
    left = replace(left, opaque=left.instances > 1)
    partly = replace(sample, context=(left, bare), targets=())
    back = sample_from_arrays(through(store, "sample", sample_to_arrays(partly)))
    assert back.context[1].depth is None
    assert back.context[1].instances is None
    np.testing.assert_array_equal(back.context[0].opaque, left.opaque)
    assert back.context[1].opaque is None or back.context[1].opaque.all()
    assert (back.context[1].camera.near, back.context[1].camera.far) == (0.5, 9.0)
    np.testing.assert_array_equal(back.context[0].depth, left.depth)
    without = replace(
        sample,
        context=tuple(replace(v, depth=None, instances=None) for v in sample.context),
        targets=(),
    )
    assert "depth" not in sample_to_arrays(without)


def test_targets_have_a_size_of_their_own(store):
    scene = datasets.load("procedural", seed=3, objects=2, views=3, height=32, width=48)
    small = scene.sample(["view_00", "view_02"], ["view_01"], (16, 24), judged="auto")
    assert small.context[0].image.shape == (16, 24, 3)
    back = sample_from_arrays(through(store, "sample", sample_to_arrays(small)))
    (target,), full = back.targets, scene.sample(["view_00", "view_02"], ["view_01"]).targets[0]
    np.testing.assert_array_equal(target.image, full.image)
    np.testing.assert_array_equal(target.camera.K, full.camera.K)
    cropped = scene.sample(["view_00", "view_02"], size=(30, 20))
    rerun = sample_from_arrays(through(store, "sample", sample_to_arrays(cropped)))
    assert [v.window for v in rerun.context] == [v.window for v in cropped.context] != [None, None]
    truth = truth_from_instances(small)
    stored = truth_from_arrays(through(store, "truth", truth_to_arrays(truth, small)))
    assert {m.shape for m in stored.masks["view_01"].values()} == {(32, 48)}


def test_targets_of_two_sizes_are_refused_in_words(sample):
    (target,) = sample.targets
    second = replace(sample, targets=(target, replace(target.resize(16, 24), name="b")))
    with pytest.raises(InputError, match="'b' is 24x16 and 'view_01' is 48x32; give a size"):
        sample_to_arrays(second)


def test_truth_with_and_without_boxes(sample, store):
    masks = truth_from_instances(sample).masks
    rng = np.random.default_rng(0)
    boxes = {v: {q: rng.random((i % 3, 4)) for i, q in enumerate(m)} for v, m in masks.items()}
    for truth in (Truth(), Truth(masks), Truth(masks, boxes)):
        arrays = through(store, "truth", truth_to_arrays(truth, sample))
        assert arrays["masks"].shape[1:] == (32, 48)
        back = truth_from_arrays(arrays)
        for old, new in ((truth.masks, back.masks), (truth.boxes, back.boxes)):
            assert {v: list(m) for v, m in new.items()} == {v: list(m) for v, m in old.items()}
            for view, query in ((v, q) for v in old for q in old[v]):
                np.testing.assert_array_equal(new[view][query], old[view][query])


def test_a_result_keeps_every_pixel(sample, store):
    image, mask = sample.context[0].image, sample.context[0].instances > 0
    result = SceneResult(
        scene="a",
        rows=[{"frame": "f", "query": "red ball", "iou": 0.1 + 0.2, "hit_mask": None}],
        scene_metrics={"iou": 0.1 + 0.2},
        predictions={("a@1", "f", "red ball"): mask, ("a@1", "f", "größe"): ~mask},
        pictures={"input/f": image},
    )
    arrays = through(store, "scene_result", result_to_arrays(result))
    back = result_from_arrays(arrays)
    assert (back.rows, back.scene_metrics) == (result.rows, result.scene_metrics)
    masks = {key: mask.decode() for key, mask in decode_predictions(arrays).items()}
    assert list(masks) == list(result.predictions)
    for key, mask in result.predictions.items():
        assert masks[key].dtype == bool
        np.testing.assert_array_equal(masks[key], mask)
    np.testing.assert_array_equal(decode_pngs(decode_pictures(arrays))["input/f"], image)
    nothing = SceneResult("a", [], {}, {}, {})
    empty = result_from_arrays(through(store, "scene_result", result_to_arrays(nothing)))
    assert vars(empty) == vars(nothing)
    later = replace(result, costs=[{"query_seconds": 9.0}])
    assert store.put("scene_result", result_to_arrays(later)) == store.put(
        "scene_result", result_to_arrays(result)
    )
