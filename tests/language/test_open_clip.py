"""open_clip checkpoints give the same vectors as the equal model of transformers."""

import json
import pickle
import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from small_clip import clip_model, save_tokenizer

from slgaussian.components.pretrained import model_digest
from slgaussian.errors import InputError
from slgaussian.language import load_encoder
from slgaussian.language.open_clip import convert

pytestmark = pytest.mark.usefixtures("one_thread")


RENAMES = (
    ("vision_model.encoder.layers", "visual.transformer.resblocks"),
    ("text_model.encoder.layers", "transformer.resblocks"),
    ("layer_norm1", "ln_1"),
    ("layer_norm2", "ln_2"),
    ("mlp.fc1", "mlp.c_fc"),
    ("mlp.fc2", "mlp.c_proj"),
    ("self_attn", "attn"),
    ("vision_model.embeddings.class_embedding", "visual.class_embedding"),
    ("vision_model.embeddings.patch_embedding", "visual.conv1"),
    ("vision_model.embeddings.position_embedding.weight", "visual.positional_embedding"),
    ("vision_model.pre_layrnorm", "visual.ln_pre"),
    ("vision_model.post_layernorm", "visual.ln_post"),
    ("visual_projection.weight", "visual.proj"),
    ("text_model.embeddings.token_embedding", "token_embedding"),
    ("text_model.embeddings.position_embedding.weight", "positional_embedding"),
    ("text_model.final_layer_norm", "ln_final"),
    ("text_projection.weight", "text_projection"),
)


def as_open_clip(model) -> dict[str, torch.Tensor]:
    """Convert a model to the tensors that open_clip saves."""
    theirs = {}
    for name, tensor in model.state_dict().items():
        for ours, new in RENAMES:
            name = name.replace(ours, new)
        theirs[name] = tensor.T if name in ("visual.proj", "text_projection") else tensor
    for name in [name for name in theirs if ".q_proj." in name]:
        parts = [theirs.pop(name.replace(".q_proj.", f".{x}_proj.")) for x in "qkv"]
        theirs[name.replace(".q_proj.", ".in_proj_")] = torch.cat(parts)
    return {name: tensor.contiguous() for name, tensor in theirs.items()}


def answers(model) -> list[torch.Tensor]:
    """Return the outputs of a model for fixed pictures and tokens, in its precision."""
    dtype = model.logit_scale.dtype
    vision, text = model.config.vision_config, model.config.text_config
    state = torch.Generator().manual_seed(3)
    pixels = torch.randn(2, 3, vision.image_size, vision.image_size, generator=state)
    tokens = torch.randint(text.vocab_size - 2, (3, 9), generator=state)
    tokens[:, 0], tokens[:, -3:] = text.vocab_size - 2, text.vocab_size - 1
    with torch.no_grad():
        image = model.get_image_features(pixels.to(dtype)).pooler_output
        return [image, model.get_text_features(tokens).pooler_output]


SMALL = {"hidden_size": 64, "num_attention_heads": 1, "num_hidden_layers": 1}


@pytest.mark.parametrize(
    "sizes",
    [
        {},
        {"image_size": 48, "hidden_size": 192, "num_attention_heads": 3, "num_hidden_layers": 4},
        # The widths of ViT-H, whose heads have 80 channels, and of ViT-L.
        {**SMALL, "hidden_size": 1280, "num_attention_heads": 16, "intermediate_size": 8},
        {**SMALL, "hidden_size": 1024, "num_attention_heads": 16, "intermediate_size": 8},
    ],
)
def test_convert_gives_the_outputs_of_the_transformers_model(sizes):
    model = clip_model(548, **sizes)
    actual = convert(as_open_clip(model), {}, "x").eval()
    # The same operations on the same numbers in the same order.
    for ours, theirs in zip(answers(actual), answers(model), strict=True):
        assert torch.equal(ours, theirs)
        assert ours.dtype == torch.float32 and ours.std() > 0.1


HEADS = {"vision_cfg": {"head_width": 32, "layers": 2}, "text_cfg": {"heads": 1}}


@pytest.mark.parametrize(
    ("sizes", "config", "same"),
    [
        ({}, {"quick_gelu": 0}, True),
        ({}, {"quick_gelu": True}, False),
        ({"activation": "quick_gelu"}, {"quick_gelu": True}, True),
        ({"num_attention_heads": 4}, HEADS, True),
        ({"num_attention_heads": 4}, {}, False),
    ],
)
def test_convert_takes_activation_and_heads_from_the_configuration(sizes, config, same):
    model = clip_model(548, **sizes)
    actual = convert(as_open_clip(model), config, "x").eval()
    assert torch.equal(answers(actual)[0], answers(model)[0]) == same


CONFIG = {
    "model_cfg": {
        "embed_dim": 24,
        "vision_cfg": {"image_size": 32, "layers": 2, "width": 128, "patch_size": 8},
        "text_cfg": {"context_length": 77, "vocab_size": 548, "width": 64, "heads": 1, "layers": 3},
    },
    "preprocess_cfg": {"mean": [0.5, 0.5, 0.5], "std": [0.5, 0.5, 0.5], "interpolation": "bicubic"},
}


@pytest.fixture(scope="module")
def tokens(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tokenizer")
    assert save_tokenizer(folder) == 548
    return folder


@pytest.fixture(scope="module")
def model():
    return clip_model(548)


@pytest.fixture(scope="module")
def tensors(model):
    return as_open_clip(model)


def beside(tokens, folder, config=None):
    """A folder with the tokenizer, to put a checkpoint into."""
    shutil.copytree(tokens, folder, dirs_exist_ok=True)
    if config is not None:
        (folder / "open_clip_config.json").write_text(json.dumps(config))
    return folder


def save(tensors, file):
    if file.suffix == ".safetensors":
        save_file(tensors, file)
    else:
        torch.save(tensors, file)
    return file


def regions():
    rng = np.random.default_rng(0)
    masks = np.zeros((3, 40, 50), bool)
    for i, mask in enumerate(masks):
        mask[3 * i : 20 + 5 * i, 4 * i : 30 + 2 * i] = True
    return rng.integers(0, 256, (40, 50, 3), np.uint8), masks


def encode_all(encoder):
    return np.concatenate([encoder.encode_regions(*regions()), encoder.encode_text(["red ball"])])


@pytest.fixture(scope="module")
def reference_vectors(model, tokens, tmp_path_factory):
    folder = tmp_path_factory.mktemp("folder")
    shutil.copytree(tokens, folder, dirs_exist_ok=True)
    model.save_pretrained(folder)
    return encode_all(load_encoder("clip", model=folder))


@pytest.mark.parametrize("name", ["clip.safetensors", "epoch_7.pt"])
def test_load_encoder_reads_a_checkpoint_file(tensors, tokens, reference_vectors, tmp_path, name):
    content = tensors
    if name == "epoch_7.pt":
        state = {f"module.{key}": tensor for key, tensor in tensors.items()}
        content = {"epoch": 7, "name": "run", "state_dict": state, "optimizer": {"lr": [0.1]}}
    file = save(content, beside(tokens, tmp_path) / name)
    assert np.array_equal(encode_all(load_encoder("clip", model=file)), reference_vectors)


def test_load_encoder_reads_half_precision_weights_as_float32(tensors, model, tokens, tmp_path):
    halves = {name: tensor.half() for name, tensor in tensors.items()}
    actual = load_encoder("clip", model=save(halves, beside(tokens, tmp_path) / "half.pt"))
    assert actual.network.dtype == torch.float32
    expected = model.visual_projection.weight.half().float()
    assert torch.equal(actual.network.visual_projection.weight, expected)


@pytest.mark.parametrize("name", ["open_clip_model.safetensors", "open_clip_pytorch_model.bin"])
def test_load_encoder_takes_normalisation_from_the_folder(
    tensors, tokens, reference_vectors, tmp_path, name
):
    save(tensors, (folder := beside(tokens, tmp_path, CONFIG)) / name)
    actual = encode_all(load_encoder("clip", model=folder))
    assert np.array_equal(actual[3:], reference_vectors[3:])
    assert np.abs(actual[:3] - reference_vectors[:3]).max() > 0.01


def test_openai_checkpoint_uses_quick_gelu(tensors, tokens, tmp_path):
    sizes = {"input_resolution": 32, "context_length": 77, "vocab_size": 548}
    state = {**tensors, **{name: torch.tensor(size) for name, size in sizes.items()}}
    file = save(state, beside(tokens, tmp_path) / "ViT.pt")
    config = load_encoder("clip", model=file).network.config
    assert config.vision_config.hidden_act == config.text_config.hidden_act == "quick_gelu"


def test_model_digest_of_a_checkpoint_depends_on_content_not_name(tensors, tokens, tmp_path):
    first = save(tensors, beside(tokens, tmp_path / "a") / "first.safetensors")
    copy = save(tensors, beside(tokens, tmp_path / "b") / "again.safetensors")
    assert model_digest(first) == model_digest(copy)
    beside(tokens, tmp_path / "b", CONFIG)
    assert model_digest(first) != model_digest(copy)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"visual.proj": None}, "KeyError: 'visual.proj'"),
        ({"ln_final.bias": None}, "missing keys such as text_model.final_layer_norm.bias"),
        ({"visual.transformer.resblocks.0.ls_1.gamma": torch.ones(3)}, "unexpected keys such as"),
        ({"text_projection": torch.ones(64, 23)}, "RuntimeError"),
        ({"visual.conv1.weight": torch.ones(128, 192)}, "ValueError"),
    ],
)
def test_tensors_of_another_network_raise_one_sentence(
    tensors, tokens, tmp_path, capfd, change, says
):
    content = {k: v for k, v in {**tensors, **change}.items() if v is not None}
    file = save(content, beside(tokens, tmp_path) / "clip.pt")
    with pytest.raises(InputError, match=f"are not those of a ViT .*{says}") as error:
        load_encoder("clip", model=file)
    assert str(file) in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"custom_text": True}, "custom_text True"),
        ({"vision_cfg": {"timm_model_name": "vit_base"}}, "timm_model_name 'vit_base'"),
        ({"text_cfg": {"hf_model_name": "roberta"}}, "hf_model_name 'roberta'"),
    ],
)
def test_unsupported_configuration_raises_input_error_with_its_key(
    tensors, tokens, tmp_path, change, cause
):
    folder = beside(tokens, tmp_path, {"model_cfg": CONFIG["model_cfg"] | change})
    save(tensors, folder / "open_clip_model.safetensors")
    with pytest.raises(InputError, match=f"{cause}, and models with it cannot"):
        load_encoder("clip", model=folder)


class Trap:
    """An object that creates a file when it is unpickled."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return open, (str(self.file), "w")


def test_damaged_checkpoint_raises_one_sentence_and_runs_no_code(tensors, tokens, tmp_path):
    mark, folder = tmp_path / "was-here", beside(tokens, tmp_path)
    trapped = {**tensors, "trap": Trap(mark)}
    files = [folder / "pickled.pt"]
    files[0].write_bytes(pickle.dumps(trapped))
    for k, content in enumerate((trapped, [1, 2], {"a": 1}, {1: torch.ones(1)}, torch.ones(3))):
        files.append(save(content, folder / f"{k}.pt"))
    for k, content in enumerate((b"", b"PK\x03\x04" + b"\0" * 60)):
        for suffix in ("bin", "safetensors"):
            files.append(folder / f"damaged {k}.{suffix}")
            files[-1].write_bytes(content)
    for file in files:
        with pytest.raises(InputError, match=r"cannot be read as weights \(\w+: "):
            load_encoder("clip", model=file)
    assert not mark.exists()
