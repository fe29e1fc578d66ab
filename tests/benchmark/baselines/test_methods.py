"""Requirements of every method in the table, and checks of each method's definition."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slgaussian.benchmark import metrics
from slgaussian.benchmark.answering import Answering, AnsweringView, Reader, Result
from slgaussian.benchmark.baselines import ROWS, Baseline, load_method
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.components import method as parts_method
from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.masks import load_proposer
from slgaussian.predict import load_predictor
from tests.known import known_field

PLAIN = "yellow wall"
"""The largest plainly coloured thing of the room, a third of the picture."""

LEAST_IOU = {"no-association": 0.3, "langsplat-like": 0.6}
"""With :data:`PLAIN`; 0.7 where nothing is said. Each is 0.15 or more below what was measured."""


def load_quick(name: str) -> Baseline:
    """Load a method with settings that take little time and run the same code."""
    row = ROWS[name]
    quick = {"steps": 200} if row.method == "langsplat-like" else {}
    return load_method(row.method, **{**row.settings, **quick})


@pytest.fixture(scope="module")
def room_inputs(room) -> Inputs:
    data = room.sample, room.field, room.gaussians, room.label_maps
    return Inputs(*data, load_proposer("regions"))


@pytest.fixture(scope="module")
def answering(room_inputs):
    """Each method prepared once: a function of the row's name."""
    return cache(lambda name: load_quick(name)(room_inputs))


@pytest.fixture(scope="module")
def render_view(answering, room):
    camera = room.sample.targets[0].camera
    return cache(lambda name: answering(name).render(camera))


@pytest.mark.parametrize("name", ROWS)
def test_methods_implement_the_interface(name, answering, render_view):
    assert isinstance(answering(name), Answering)
    view = render_view(name)
    assert isinstance(view, AnsweringView) and isinstance(view.reader, Reader)
    shape = 104, 144
    assert view.rgb.dtype == np.uint8 and view.rgb.shape == (*shape, 3)
    for image, kind in ((view.ids, np.int32), (view.depth, np.float32)):
        assert image.dtype == kind and image.shape == shape and image.min() >= 0
    hits = view.query_all([PLAIN, "red qqwx"])
    assert [hit.text for hit in hits] == [PLAIN, "red qqwx"]
    assert hits[1].unknown == view.reader.unknown_words("red qqwx") == ("qqwx",)
    for hit in hits:
        assert isinstance(hit, Result)
        assert hit.mask.dtype == bool and hit.mask.shape == shape
        assert hit.relevancy.dtype == np.float32 and hit.relevancy.shape == shape
        assert 0 <= hit.relevancy.min() <= hit.relevancy.max() <= 1
        x, y = hit.point
        assert 0 <= x < shape[1] and 0 <= y < shape[0]
        assert hit.score == pytest.approx(hit.relevancy.max(), abs=1e-6)
    labels = view.segment([PLAIN, "wooden floor"])
    assert labels.dtype == np.int32 and set(np.unique(labels)) <= {0, 1, 2}


@pytest.mark.parametrize("name", ROWS)
def test_methods_find_an_object_by_its_colour(name, render_view, room):
    (hit,) = render_view(name).query_all([PLAIN])
    mask = room.truth["view_01"][PLAIN]
    assert metrics.point_in_mask(hit.point, mask)
    assert metrics.iou(hit.mask, mask) > LEAST_IOU.get(name, 0.7)
    # And not by taking everything.
    assert hit.mask.mean() < 0.75
    (hit,) = render_view(name).query_all([PLAIN], threshold=0.52)
    sure = np.abs(hit.relevancy - 0.52) > 1e-6  # relevancy is rounded to float32
    assert np.array_equal(hit.mask[sure], hit.relevancy[sure] > 0.52)


def test_langsplat_like_renders_large_vectors_smaller(answering, room, monkeypatch):
    method, limit = answering("langsplat-like"), "langsplat_like.MAX_ELEMENTS"
    camera = room.sample.targets[0].camera
    numbers = method.render(camera).vectors.size
    for share, shape in ((1, (104, 144)), (4, (52, 72)), (5, (26, 36))):
        monkeypatch.setattr(f"slgaussian.benchmark.baselines.{limit}", numbers // share)
        view = method.render(camera)
        assert view.vectors.shape[:2] == shape and view.rgb.shape == (104, 144, 3)
        (hit,) = view.query_all([PLAIN])
        assert metrics.iou(hit.mask, room.truth["view_01"][PLAIN]) > LEAST_IOU["langsplat-like"]


@pytest.mark.parametrize("name", ["langsplat-like", "no-association"])
def test_methods_are_deterministic(name, room_inputs, render_view, room):
    texts = list(room.truth["view_01"])
    inputs = replace(room_inputs)  # without cached results
    repeated = load_quick(name)(inputs).render(room.sample.targets[0].camera)

    def answers(view):
        images = [view.rgb, view.ids, view.depth, view.segment(texts)]
        hits = view.query_all(texts)
        images += [image for hit in hits for image in (hit.relevancy, hit.mask)]
        return [image.tobytes() for image in images], [(hit.point, hit.score) for hit in hits]

    assert answers(repeated) == answers(render_view(name))


def test_load_method_refuses_unknown_settings():
    with pytest.raises(InputError, match="unknown method"):
        load_method("lseg")
    with pytest.raises(InputError, match="settings of 'langsplat-like'"):
        load_method("langsplat-like", optimised=True)


def test_no_association_separates_objects_by_view(answering, room_inputs):
    bank = answering("no-association").bank
    assert (bank.present.sum(1) == 1).all()
    ids = [set(np.unique(labels)) - {0} for labels in room_inputs.own_labels.labels]
    assert len(ids) == 2 and not ids[0] & ids[1]
    assert sorted(ids[0] | ids[1]) == bank.ids.tolist() == list(range(1, len(bank) + 1))


def test_no_bank_averages_features_over_views(answering, room):
    bank, mean = room.field.bank, answering("no-bank").bank
    assert mean.present.shape == (len(bank), 1)
    for k in range(len(bank)):
        vectors = bank.features[k][bank.present[k]].astype(np.float64)
        expected = vectors.mean(0) / np.linalg.norm(vectors.mean(0))
        # Half precision: 2^-11 of the largest entry, which is below 1.
        np.testing.assert_allclose(mean.features[k, 0], expected, atol=2**-11)


@pytest.mark.parametrize("name", ["query-2d", "query-2d, depth", "langsplat-like"])
def test_methods_find_nothing_in_an_empty_view(name, answering, room):
    camera = room.sample.targets[0].camera
    away = camera.c2w.copy()
    away[:3, 3] -= 100 * camera.c2w[:3, 2]
    away[:3, :3] = away[:3, :3] @ np.diag([-1.0, 1, -1])
    view = answering(name).render(replace(camera, c2w=away))
    (hit,) = view.query_all([PLAIN])
    assert hit.point is None and hit.score == 0
    for image in (view.rgb, hit.mask, hit.relevancy, view.segment([PLAIN, "wooden floor"])):
        assert not image.any()


def test_methods_accept_another_encoder(room, tmp_path_factory):
    pytest.importorskip("transformers")
    from tests.language.small_clip import save_clip

    model = save_clip(tmp_path_factory.mktemp("methods") / "clip")
    sample = room.sample.resize(64, 64)
    labels = np.stack([view.instances for view in sample.context])
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    gaussians = load_predictor("planesweep")(sample)
    method = parts_method.Method(encoder="clip", settings={"clip": {"model": str(model)}})
    field = known_field(sample, gaussians, label_maps, method)
    inputs = Inputs(sample, field, gaussians, label_maps, load_proposer("regions"))
    for name in ("slgaussian", "query-2d", "langsplat-like"):
        view = load_quick(name)(inputs).render(sample.targets[0].camera)
        (hit,) = view.query_all(["red ball"])
        assert hit.relevancy.shape == (64, 64) and hit.point is not None
