import copy

import cv2
import numpy as np
import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.language import classifier, weights
from slgaussian.language.class_evidence import STEP, evidence, quantised
from slgaussian.language.nouns import noun_classes

needs_weights = pytest.mark.skipif(
    weights.find_weights() is None, reason=f"needs the weights: {weights.INSTALL}"
)


def photograph(height=96, width=128):
    rows, columns = np.mgrid[:height, :width]
    waves = [np.sin(rows / 5 + columns / (k + 3)) for k in range(3)]
    return (127 + 120 * np.stack(waves, 2)).astype(np.uint8)


def test_regions_have_the_mean_of_their_cells():
    rng = np.random.default_rng(0)
    cells = rng.normal(size=(3, 4, 7)).astype(np.float32)
    masks = rng.random((5, 12, 16)) > 0.6
    fine = cells.repeat(4, 0).repeat(4, 1).astype(np.float64)
    expected = [fine[mask].mean(0) for mask in masks]
    assert np.allclose(classifier.pool(cells, masks), expected, atol=1e-5)
    assert classifier.pool(cells, masks[:0]).shape == (0, 7)


def test_evidence_is_the_log_of_how_much_likelier_the_classes_are():
    rng = np.random.default_rng(1)
    regions, photographs = rng.uniform(-9, -1, (2, 3, 1000)), rng.uniform(-9, -1, (3, 1000))
    stored = quantised(regions), quantised(photographs)
    lead = evidence(*stored, (4, 9))
    sums = [np.exp(x[..., [4, 9]]).sum(-1) for x in (regions, photographs)]
    assert lead.shape == (2, 3)
    assert np.allclose(lead, np.log(sums[0] / sums[1]), atol=STEP)


@needs_weights
def test_network_agrees_with_float64():
    network = classifier.load().network
    x = torch.from_numpy(photograph()).permute(2, 0, 1)[None] / 128.0 - 1
    with torch.inference_mode():
        fast, exact = network(x), copy.deepcopy(network).double()(x.double())
    assert fast.shape == (3, 4, 1000)
    assert (fast - exact).abs().max() < 1e-3


@needs_weights
def test_class_map_names_what_a_photograph_shows():
    """A banana, drawn: yellow, bent, on white."""
    image = np.full((300, 400, 3), 255, np.uint8)
    cv2.ellipse(image, (200, 60), (140, 150), 0, 20, 160, (240, 210, 60), 50)
    scores = classifier.load().class_map(image)
    assert scores.shape == (22, 30, 1000)
    assert scores.dtype == np.float32
    assert np.allclose(np.logaddexp.reduce(scores, 2), 0, atol=2)
    bananas = noun_classes()["banana"]
    inside = np.zeros((1, 300, 400), bool)
    inside[0, 150:240, 100:300] = True
    pooled = classifier.pool(scores, inside)[0]
    assert set(bananas) <= set(np.argsort(-pooled)[:20])


@needs_weights
def test_refuses_other_weights(tmp_path):
    (tmp_path / "weights.pth").write_bytes(b"others")
    with pytest.raises(InputError, match=r"is not the file of .* install it again"):
        classifier.Classifier(tmp_path / "weights.pth")


@pytest.mark.parametrize(
    ("word", "classes"),
    [
        ("radiator", {753, 811}),
        ("fox", {277, 278, 279, 280}),
        ("goldfish", {1}),
        ("trash can", {412}),
        ("collie", {231}),
    ],
)
def test_nouns_mean_classes(word, classes):
    assert set(noun_classes()[word]) == classes


def test_nouns_above_mean_all_that_they_hold():
    table = noun_classes()
    assert {954, 948} <= set(table["fruit"])
    assert {559, 831} <= set(table["furniture"])
    assert len(table["dog"]) > 100
    assert set(table["dog"]) < set(table["animal"])
    assert "object" not in table
    assert "person" not in table
