"""Dense classification: the network compared with PyTorch in float64, and its scores."""

import cv2
import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional as F

from slgaussian.errors import InputError
from slgaussian.formats import tensorfile
from slgaussian.language import classifier, configs
from slgaussian.language.classifier import LOG_STEP, evidence, quantize
from slgaussian.language.vocabulary import noun_classes

needs_weights = pytest.mark.skipif(
    configs.find_weights() is None, reason=f"needs the weights: {configs.INSTALL}"
)


def photograph(height=96, width=128):
    rows, columns = np.mgrid[:height, :width]
    waves = [np.sin(rows / 5 + columns / (k + 3)) for k in range(3)]
    return (127 + 120 * np.stack(waves, 2)).astype(np.uint8)


def test_pool_averages_cells_over_regions():
    rng = np.random.default_rng(0)
    cells = rng.normal(size=(3, 4, 7)).astype(np.float32)
    masks = rng.random((5, 12, 16)) > 0.6
    fine = cells.repeat(4, 0).repeat(4, 1).astype(np.float64)
    expected = [fine[mask].mean(0) for mask in masks]
    assert np.allclose(classifier.pool(cells, masks), expected, atol=1e-5)
    assert classifier.pool(cells, masks[:0]).shape == (0, 7)


def test_evidence_is_the_log_ratio_of_class_probabilities():
    rng = np.random.default_rng(1)
    regions, photographs = rng.uniform(-9, -1, (2, 3, 1000)), rng.uniform(-9, -1, (3, 1000))
    stored = quantize(regions), quantize(photographs)
    lead = evidence(*stored, (4, 9))
    sums = [np.exp(x[..., [4, 9]]).sum(-1) for x in (regions, photographs)]
    assert lead.shape == (2, 3)
    assert np.allclose(lead, np.log(sums[0] / sums[1]), atol=LOG_STEP)


class Convolution(nn.Conv2d):
    """A convolution padded as TensorFlow pads ``SAME``."""

    def forward(self, x):
        step, kernel = self.stride[0], self.kernel_size[0]
        pads = []
        for size in (x.shape[-1], x.shape[-2]):
            total = max((-(-size // step) - 1) * step + kernel - size, 0)
            pads += [total // 2, total - total // 2]
        return super().forward(F.pad(x, pads))


class Block(nn.Module):
    """An inverted residual, written from the paper; the names of layers are those of the file."""

    def __init__(self, kernel, step, expand, into, out):
        super().__init__()
        wide = into * expand
        self.expands, self.skips = expand > 1, step == 1 and into == out
        if self.expands:
            self._expand_conv = Convolution(into, wide, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(wide, eps=1e-3)
        self._depthwise_conv = Convolution(wide, wide, kernel, step, groups=wide, bias=False)
        self._bn1 = nn.BatchNorm2d(wide, eps=1e-3)
        self._project_conv = Convolution(wide, out, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(out, eps=1e-3)

    def forward(self, x):
        y = F.relu6(self._bn0(self._expand_conv(x))) if self.expands else x
        y = F.relu6(self._bn1(self._depthwise_conv(y)))
        y = self._bn2(self._project_conv(y))
        return x + y if self.skips else y


class Lite0(nn.Module):
    """The network in PyTorch, by table 1 of Tan and Le: the reference, in float64."""

    def __init__(self):
        super().__init__()
        self._conv_stem = Convolution(3, 32, 3, 2, bias=False)
        self._bn0 = nn.BatchNorm2d(32, eps=1e-3)
        stages = [
            (1, 3, 1, 1, 32, 16),
            (2, 3, 2, 6, 16, 24),
            (2, 5, 2, 6, 24, 40),
            (3, 3, 2, 6, 40, 80),
            (3, 5, 1, 6, 80, 112),
            (4, 5, 2, 6, 112, 192),
            (1, 3, 1, 6, 192, 320),
        ]
        self._blocks = nn.ModuleList(
            Block(kernel, step if n == 0 else 1, expand, into if n == 0 else out, out)
            for repeats, kernel, step, expand, into, out in stages
            for n in range(repeats)
        )
        self._conv_head = Convolution(320, 1280, 1, bias=False)
        self._bn1 = nn.BatchNorm2d(1280, eps=1e-3)
        self._fc = nn.Linear(1280, 1000)

    def forward(self, x):
        x = F.relu6(self._bn0(self._conv_stem(x)))
        for block in self._blocks:
            x = block(x)
        x = F.relu6(self._bn1(self._conv_head(x)))
        x = F.avg_pool2d(x, 3, 1, 1, count_include_pad=False)
        return self._fc(x[0].permute(1, 2, 0)).log_softmax(-1)


@needs_weights
def test_network_equals_the_float64_reference_for_all_sizes_and_threads():
    network = Lite0()
    network.load_state_dict(tensorfile.load(configs.find_weights()))
    network.double().eval()
    fast = classifier.load()
    noise = np.random.default_rng(0).uniform(-1, 1, (320, 64, 3)).astype(np.float32)
    before = cv2.getNumThreads()
    try:
        for pixels in (photograph() / np.float32(128) - 1, noise, 0 * noise[:32, :32]):
            results = []
            for threads in (1, 2, 3):
                cv2.setNumThreads(threads)
                results.append(fast.cell_scores(pixels))
            with torch.inference_mode():
                exact = network(torch.from_numpy(pixels).double().permute(2, 0, 1)[None])
            assert results[0].shape == (pixels.shape[0] // 32, pixels.shape[1] // 32, 1000)
            assert np.abs(results[0] - exact.numpy()).max() < 1e-3
            assert all(np.array_equal(result, results[0]) for result in results)
    finally:
        cv2.setNumThreads(before)


@needs_weights
def test_class_map_ranks_the_banana_of_a_drawing():
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
def test_classifier_raises_input_error_for_other_weights(tmp_path):
    (tmp_path / "weights.pth").write_bytes(b"others")
    with pytest.raises(InputError, match=r"is not the file of .* install it again"):
        classifier.Classifier(tmp_path / "weights.pth")


def test_hypernyms_have_the_classes_of_their_hyponyms():
    table = noun_classes()
    assert {954, 948} <= set(table["fruit"])
    assert {559, 831} <= set(table["furniture"])
    assert len(table["dog"]) > 100
    assert set(table["dog"]) < set(table["animal"])
    assert "object" not in table
    assert "person" not in table
