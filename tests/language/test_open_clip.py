"""open_clip checkpoints give the same vectors as the model of transformers that they stand for."""

import json
import pickle
import re
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


def as_open_clip(model) -> dict[str, torch.Tensor]:
    """What open_clip would save of the same model."""
    theirs = {}
    tensors = dict(model.state_dict())
    for tower, inside in (("vision_model", "visual."), ("text_model", "")):
        pattern = re.compile(rf"{tower}\.encoder\.layers\.(\d+)\.self_attn\.q_proj\.weight")
        for number in [match[1] for match in map(pattern.fullmatch, list(tensors)) if match]:
            ours, block = f"{tower}.encoder.layers.{number}.", f"{inside}transformer.resblocks."
            block += f"{number}."
            for kind in ("weight", "bias"):
                parts = [tensors.pop(f"{ours}self_attn.{x}_proj.{kind}") for x in "qkv"]
                theirs[f"{block}attn.in_proj_{kind}"] = torch.cat(parts)
                theirs[f"{block}attn.out_proj.{kind}"] = tensors.pop(
                    f"{ours}self_attn.out_proj.{kind}"
                )
                theirs[f"{block}ln_1.{kind}"] = tensors.pop(f"{ours}layer_norm1.{kind}")
                theirs[f"{block}mlp.c_fc.{kind}"] = tensors.pop(f"{ours}mlp.fc1.{kind}")
                theirs[f"{block}mlp.c_proj.{kind}"] = tensors.pop(f"{ours}mlp.fc2.{kind}")
                theirs[f"{block}ln_2.{kind}"] = tensors.pop(f"{ours}layer_norm2.{kind}")
    take = tensors.pop
    theirs["visual.class_embedding"] = take("vision_model.embeddings.class_embedding")
    theirs["visual.conv1.weight"] = take("vision_model.embeddings.patch_embedding.weight")
    theirs["visual.positional_embedding"] = take(
        "vision_model.embeddings.position_embedding.weight"
    )
    theirs["visual.proj"] = take("visual_projection.weight").T
    theirs["token_embedding.weight"] = take("text_model.embeddings.token_embedding.weight")
    theirs["positional_embedding"] = take("text_model.embeddings.position_embedding.weight")
    theirs["text_projection"] = take("text_projection.weight").T
    theirs["logit_scale"] = take("logit_scale")
    for kind in ("weight", "bias"):
        theirs[f"visual.ln_pre.{kind}"] = take(f"vision_model.pre_layrnorm.{kind}")
        theirs[f"visual.ln_post.{kind}"] = take(f"vision_model.post_layernorm.{kind}")
        theirs[f"ln_final.{kind}"] = take(f"text_model.final_layer_norm.{kind}")
    assert not tensors
    return {name: tensor.contiguous() for name, tensor in theirs.items()}


def answers(model) -> list[torch.Tensor]:
    """What a model says to fixed pictures and tokens, in its own precision."""
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
def test_the_converted_model_says_the_same(sizes, dtype=torch.float32):
    model = clip_model(548, **sizes)
    found = convert(as_open_clip(model), {}, "x").eval().to(dtype)
    # The same operations on the same numbers in the same order.
    for ours, theirs in zip(answers(found), answers(model.to(dtype)), strict=True):
        assert torch.equal(ours, theirs)
        assert ours.dtype == dtype and ours.std() > 0.1


def test_the_activation_is_what_the_configuration_says():
    exact, quick = clip_model(548), clip_model(548, activation="quick_gelu")
    tensors = as_open_clip(exact)
    for config, model in (({}, exact), ({"quick_gelu": True}, quick), ({"quick_gelu": 0}, exact)):
        found = convert(tensors, config, "x").eval()
        assert torch.equal(answers(found)[0], answers(model)[0])
    assert not torch.equal(answers(quick)[0], answers(exact)[0])


def test_heads_are_as_many_as_the_configuration_says():
    model = clip_model(548, num_attention_heads=4)
    config = {"vision_cfg": {"head_width": 32, "layers": 2}, "text_cfg": {"heads": 1}}
    found = convert(as_open_clip(model), config, "x").eval()
    assert torch.equal(answers(found)[0], answers(model)[0])
    assert not torch.equal(
        answers(convert(as_open_clip(model), {}, "x").eval())[0], answers(model)[0]
    )


# --- Files ---------------------------------------------------------------------------------------

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


def said(encoder):
    return np.concatenate([encoder.encode_regions(*regions()), encoder.encode_text(["red ball"])])


@pytest.fixture(scope="module")
def expected(model, tokens, tmp_path_factory):
    folder = tmp_path_factory.mktemp("folder")
    shutil.copytree(tokens, folder, dirs_exist_ok=True)
    model.save_pretrained(folder)
    return said(load_encoder("clip", model=folder))


@pytest.mark.parametrize("name", ["clip.safetensors", "epoch_7.pt"])
def test_a_file_is_converted(tensors, tokens, expected, tmp_path, name):
    content = tensors
    if name == "epoch_7.pt":
        state = {f"module.{key}": tensor for key, tensor in tensors.items()}
        content = {"epoch": 7, "name": "run", "state_dict": state, "optimizer": {"lr": [0.1]}}
    file = save(content, beside(tokens, tmp_path) / name)
    assert np.array_equal(said(load_encoder("clip", model=file)), expected)


def test_weights_in_half_precision_are_read_as_they_are(tensors, model, tokens, tmp_path):
    halves = {name: tensor.half() for name, tensor in tensors.items()}
    found = load_encoder("clip", model=save(halves, beside(tokens, tmp_path) / "half.pt"))
    assert found.network.dtype == torch.float32
    expected = model.visual_projection.weight.half().float()
    assert torch.equal(found.network.visual_projection.weight, expected)


@pytest.mark.parametrize("name", ["open_clip_model.safetensors", "open_clip_pytorch_model.bin"])
def test_a_folder_says_how_colours_are_normalised(tensors, tokens, expected, tmp_path, name):
    save(tensors, (folder := beside(tokens, tmp_path, CONFIG)) / name)
    found = said(load_encoder("clip", model=folder))
    assert np.array_equal(found[3:], expected[3:])
    assert np.abs(found[:3] - expected[:3]).max() > 0.01


def test_tensors_of_openais_checkpoints_have_sizes_and_quick_gelu(tensors, tokens, tmp_path):
    sizes = {"input_resolution": 32, "context_length": 77, "vocab_size": 548}
    state = {**tensors, **{name: torch.tensor(size) for name, size in sizes.items()}}
    file = save(state, beside(tokens, tmp_path) / "ViT.pt")
    config = load_encoder("clip", model=file).network.config
    assert config.vision_config.hidden_act == config.text_config.hidden_act == "quick_gelu"


def test_a_checkpoint_is_known_by_content_and_not_by_name(tensors, tokens, tmp_path):
    first = save(tensors, beside(tokens, tmp_path / "a") / "first.safetensors")
    again = save(tensors, beside(tokens, tmp_path / "b") / "again.safetensors")
    assert model_digest(first) == model_digest(again)
    beside(tokens, tmp_path / "b", CONFIG)
    assert model_digest(first) != model_digest(again)


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
def test_tensors_that_are_no_clip_are_one_sentence(tensors, tokens, tmp_path, capfd, change, says):
    content = {k: v for k, v in {**tensors, **change}.items() if v is not None}
    file = save(content, beside(tokens, tmp_path) / "clip.pt")
    with pytest.raises(InputError, match=f"are not those of a ViT .*{says}") as error:
        load_encoder("clip", model=file)
    assert str(file) in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("", "custom_text", True),
        ("vision_cfg", "timm_model_name", "vit_base"),
        ("text_cfg", "hf_model_name", "roberta"),
    ],
)
def test_a_model_of_another_make_is_named(tensors, tokens, tmp_path, table, key, value):
    config = json.loads(json.dumps(CONFIG))
    (config["model_cfg"][table] if table else config["model_cfg"])[key] = value
    folder = beside(tokens, tmp_path, config)
    save(tensors, folder / "open_clip_model.safetensors")
    with pytest.raises(InputError, match=rf"{key} {value!r}, and models with it cannot"):
        load_encoder("clip", model=folder)


class Trap:
    """Unpickled by a careless reader, it leaves a file behind."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return open, (str(self.file), "w")


def test_no_code_of_a_checkpoint_is_run(tensors, tokens, tmp_path):
    mark = tmp_path / "was-here"
    for name, dump in (("a.pt", torch.save), ("b.pt", lambda x, f: f.write_bytes(pickle.dumps(x)))):
        file = beside(tokens, tmp_path) / name
        dump({**tensors, "trap": Trap(mark)}, file)
        with pytest.raises(InputError, match=r"cannot be read as weights \(\w+: "):
            load_encoder("clip", model=file)
        assert not mark.exists()


@pytest.mark.parametrize("name", ["clip.pt", "clip.safetensors"])
@pytest.mark.parametrize("content", [b"", b"PK\x03\x04" + b"\0" * 60])
def test_a_file_that_is_no_checkpoint_is_one_sentence(tokens, tmp_path, name, content):
    file = beside(tokens, tmp_path) / name
    file.write_bytes(content)
    with pytest.raises(InputError, match="cannot be read as weights"):
        load_encoder("clip", model=file)


@pytest.mark.parametrize("content", [[1, 2], {"a": 1}, {1: torch.ones(1)}, torch.ones(3)])
def test_a_checkpoint_of_other_things_is_one_sentence(tokens, tmp_path, content):
    file = save(content, beside(tokens, tmp_path) / "clip.pt")
    with pytest.raises(InputError, match="cannot be read as weights"):
        load_encoder("clip", model=file)
