"""Which files are taken for checkpoints, and what is said of others."""

import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.predict import load_predictor
from slgaussian.predict.mvsplat.checkpoint import load_network, with_weights
from slgaussian.predict.mvsplat.config import PUBLISHED


def test_lightning_and_bare_dictionaries_load_alike(network, weights, tmp_path):
    torch.save(weights, tmp_path / "bare.pt")
    bare = load_network(tmp_path / "bare.pt").state_dict()
    for name, value in network.state_dict().items():
        assert torch.equal(value, weights[name])
        assert torch.equal(value, bare[name])


def test_all_that_does_not_fit_is_named(weights):
    state = dict(weights)
    for name in [n for n in state if n.startswith("backbone.transformer.layers.5")]:
        del state[name]
    state["extra.weight"] = torch.zeros(1)
    state["backbone.backbone.conv2.bias"] = torch.zeros(64)
    with pytest.raises(InputError) as caught:
        with_weights(state, PUBLISHED, "odd.ckpt")
    message = str(caught.value)
    assert "odd.ckpt" in message
    assert "16 missing: backbone.transformer.layers.5." in message
    assert "1 unexpected: extra.weight" in message
    assert "1 of another shape: backbone.backbone.conv2.bias" in message


class Harmful:
    def __reduce__(self):
        return eval, ("1 / 0",)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ([1, 2, 3], "471 missing"),
        ({"state_dict": {"a": 1}}, "471 missing"),
        ({"weight": torch.zeros(2)}, "471 missing"),
        ({"state_dict": Harmful()}, r"holds more than tensors \(eval\)"),
    ],
)
def test_other_contents(content, expected, tmp_path):
    path = tmp_path / "file.ckpt"
    torch.save(content, path)
    with pytest.raises(InputError, match=expected):
        load_predictor("mvsplat", checkpoint=path)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "there is no such file"),
        (b"<html>Sign in to download</html>", r"a.ckpt: is damaged or no PyTorch file \(it cannot"),
        (b"", r"a.ckpt: "),
        ("cut", r"a.ckpt: "),
    ],
)
def test_files_that_are_no_checkpoints(checkpoint, tmp_path, content, sentence):
    if content == "cut":
        content = checkpoint.read_bytes()[:100_000]
    if content is not None:
        (tmp_path / "a.ckpt").write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        load_network(tmp_path / "a.ckpt")
