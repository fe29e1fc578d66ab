"""Files that are read as checkpoints, and messages about others."""

import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.predict import load_predictor
from slgaussian.predict.mvsplat.checkpoint import load_network


def test_lightning_and_bare_dictionaries_load_alike(network, weights, tmp_path):
    torch.save(weights, tmp_path / "bare.pt")
    bare = load_network(tmp_path / "bare.pt").state_dict()
    for name, value in network.state_dict().items():
        assert torch.equal(value, weights[name])
        assert torch.equal(value, bare[name])


def test_all_that_does_not_fit_is_named(weights, tmp_path):
    state = dict(weights)
    for name in [n for n in state if n.startswith("backbone.transformer.layers.5")]:
        del state[name]
    state["extra.weight"] = torch.zeros(1)
    state["backbone.backbone.conv2.bias"] = torch.zeros(64)
    torch.save(state, tmp_path / "odd.ckpt")
    with pytest.raises(InputError) as caught:
        load_network(tmp_path / "odd.ckpt")
    assert (
        "odd.ckpt: does not fit the network of 471 tensors (16 missing: backbone.transformer."
        "layers.5.cross_attn_ffn.k_proj.weight; 1 unexpected: extra.weight; 1 of another shape: "
        "backbone.backbone.conv2.bias, ...)"
    ) in str(caught.value)


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
        (None, "there is no such file"),
        (b"<html>Sign in to download</html>", r"a.ckpt: is damaged or no PyTorch file \(it cannot"),
        (b"", r"a.ckpt: "),
        ("cut", r"a.ckpt: "),
    ],
)
def test_other_files(content, expected, checkpoint, tmp_path):
    path = tmp_path / "a.ckpt"
    if content == "cut":
        content = checkpoint.read_bytes()[:100_000]
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        torch.save(content, path)
    with pytest.raises(InputError, match=expected):
        load_predictor("mvsplat", checkpoint=path)
