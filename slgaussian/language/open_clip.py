"""Conversion of open_clip checkpoints to ``CLIPModel`` of ``transformers``, by renaming tensors.

Both implement the same architecture. open_clip stores the three projections of an attention in one
tensor and the two output projections transposed (names and layouts are those of the ``state_dict``
in https://github.com/mlfoundations/open_clip and https://github.com/huggingface/transformers).
Sizes are inferred from the tensors. Activation and number of heads are read from
``open_clip_config.json`` or, without it, are those of open_clip's models of the same width.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from slgaussian.components.pretrained import (
    OPEN_CLIP_CONFIG,
    ModelFiles,
    quiet_transformers,
    read_json,
    table_in,
)
from slgaussian.errors import InputError
from slgaussian.formats import tensorfile

HEAD_WIDTHS = {1280: 80, 1408: 88, 1664: 104, 1792: 112}
"""Head dimension in the image towers of open_clip's ViT-H, g, bigG and e, by width; 64 in all other
image towers, and in all text towers."""

UNDERSTOOD = {
    "": {"embed_dim", "vision_cfg", "text_cfg", "quick_gelu"},
    "vision_cfg": {
        "image_size", "layers", "width", "patch_size", "head_width", "mlp_ratio", "patch_dropout",
    },
    "text_cfg": {"context_length", "vocab_size", "width", "heads", "layers", "mlp_ratio"},
}  # fmt: skip
"""Supported configuration keys, by table, including those that only training uses. Any other key
with a value that is neither empty nor false is a feature that CLIPModel lacks."""

TOWERS = {"visual.transformer": "vision_model.encoder", "transformer": "text_model.encoder"}
LAYER = {
    "ln_1": "layer_norm1",
    "ln_2": "layer_norm2",
    "attn.out_proj": "self_attn.out_proj",
    "mlp.c_fc": "mlp.fc1",
    "mlp.c_proj": "mlp.fc2",
}
WHOLE = {
    "visual.class_embedding": "vision_model.embeddings.class_embedding",
    "visual.conv1.weight": "vision_model.embeddings.patch_embedding.weight",
    "visual.positional_embedding": "vision_model.embeddings.position_embedding.weight",
    "visual.ln_pre.weight": "vision_model.pre_layrnorm.weight",
    "visual.ln_pre.bias": "vision_model.pre_layrnorm.bias",
    "visual.ln_post.weight": "vision_model.post_layernorm.weight",
    "visual.ln_post.bias": "vision_model.post_layernorm.bias",
    "visual.proj": "visual_projection.weight",
    "token_embedding.weight": "text_model.embeddings.token_embedding.weight",
    "positional_embedding": "text_model.embeddings.position_embedding.weight",
    "ln_final.weight": "text_model.final_layer_norm.weight",
    "ln_final.bias": "text_model.final_layer_norm.bias",
    "text_projection": "text_projection.weight",
    "logit_scale": "logit_scale",
}
OPENAI_SIZES = {"input_resolution", "context_length", "vocab_size"}
"""Scalar tensors that only OpenAI's own checkpoints have; all of these use QuickGELU."""

TRANSPOSED = ("visual.proj", "text_projection")


def load_open_clip(files: ModelFiles) -> Any:
    """Load a checkpoint as a float32 ``CLIPModel``.

    Args:
        files: Files with a checkpoint: ``.safetensors``, or a ``torch.save`` file that holds only
            tensors, at top level or under ``state_dict``.

    Raises:
        InputError: If the file cannot be read, a tensor is missing, unexpected or has a wrong
            shape, or the configuration has a feature that CLIPModel lacks.
    """
    config: Mapping[str, Any] = {}
    for file in files.files:
        if file.name == OPEN_CLIP_CONFIG:
            config = _read_config(file)
    assert files.checkpoint is not None  # models in folders need no conversion
    return convert(_read_tensors(files.checkpoint), config, str(files.checkpoint))


def convert(tensors: Mapping[str, torch.Tensor], config: Mapping[str, Any], source: str) -> Any:
    """Convert the tensors of an open_clip model to a ``CLIPModel``.

    Args:
        tensors: {open_clip's name: tensor}. 302 for a ViT-B.
        config: ``model_cfg`` of ``open_clip_config.json``, or empty.
        source: Name of the model in messages.

    Raises:
        InputError: As :func:`load_open_clip`.
    """
    from transformers import CLIPConfig, CLIPModel

    if OPENAI_SIZES & tensors.keys():
        tensors = {name: tensor for name, tensor in tensors.items() if name not in OPENAI_SIZES}
        config = {"quick_gelu": True, **config}
    layers = {tower: _count_layers(tensors, tower) for tower in TOWERS}
    names = _names(layers)
    missing, extra = sorted(names.keys() - tensors.keys()), sorted(tensors.keys() - names.keys())
    if missing or extra:
        problems = [
            f"{problem}, such as {tensor_names[0]}"
            for problem, tensor_names in (
                (f"lacks {len(missing)} of the tensors of open_clip's ViTs", missing),
                (f"has {len(extra)} that they have not", extra),
            )
            if tensor_names
        ]
        raise InputError(
            f"model {source}: {' and '.join(problems)}; expected an open_clip checkpoint with a "
            "ViT and a text transformer, such as ViT-B-16"
        )
    network_config = CLIPConfig.from_dict(_sizes(tensors, layers, config, source))
    renamed: dict[str, torch.Tensor] = {}
    for theirs, ours in names.items():
        tensor = tensors[theirs].to(torch.float32)
        if "{}" in ours:
            for letter, part in zip("qkv", tensor.chunk(3), strict=True):
                renamed[ours.format(letter)] = part.clone()
        else:
            renamed[ours] = tensor.T.contiguous() if theirs in TRANSPOSED else tensor
    renamed["logit_scale"] = renamed["logit_scale"].reshape(())
    try:
        with quiet_transformers():
            network, report = CLIPModel.from_pretrained(
                None,
                config=network_config,
                state_dict=renamed,
                dtype=torch.float32,
                output_loading_info=True,
            )
        if report["missing_keys"]:
            raise KeyError(f"nothing for {min(report['missing_keys'])} of CLIPModel")
    except Exception as problem:  # layers raise exceptions of any type
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"model {source}: its tensors do not fit each other ({reason}); get it again"
        ) from None
    return network


def _count_layers(tensors: Mapping[str, torch.Tensor], tower: str) -> int:
    pattern = re.compile(re.escape(tower) + r"\.resblocks\.(\d+)\.")
    numbers = [int(match[1]) for match in map(pattern.match, tensors) if match]
    return 1 + max(numbers, default=0)


def _names(layers: Mapping[str, int]) -> dict[str, str]:
    """Map open_clip's names to those of transformers; {} stands for each of q, k and v."""
    names = dict(WHOLE)
    for tower, count in layers.items():
        for i in range(count):
            theirs, ours = f"{tower}.resblocks.{i}", f"{TOWERS[tower]}.layers.{i}"
            for kind in ("weight", "bias"):
                names[f"{theirs}.attn.in_proj_{kind}"] = f"{ours}.self_attn.{{}}_proj.{kind}"
                for part, counterpart in LAYER.items():
                    names[f"{theirs}.{part}.{kind}"] = f"{ours}.{counterpart}.{kind}"
    return names


def _sizes(
    tensors: Mapping[str, torch.Tensor],
    layers: Mapping[str, int],
    config: Mapping[str, Any],
    source: str,
) -> dict[str, Any]:
    """Infer the configuration of CLIPModel."""
    shape = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    ranks = {"visual.conv1.weight": 4, "visual.proj": 2, "visual.positional_embedding": 2}
    ranks |= {"positional_embedding": 2, "token_embedding.weight": 2, "ln_final.weight": 1}
    ranks |= {f"{tower}.resblocks.0.mlp.c_fc.weight": 2 for tower in TOWERS}
    for name, rank in ranks.items():
        if len(shape[name]) != rank:
            raise InputError(f"model {source}: {name} is {shape[name]}, expected {rank} axes")
    width, _, patch, _ = shape["visual.conv1.weight"]
    vocabulary, text_width = shape["token_embedding.weight"]
    head = config.get("vision_cfg", {}).get("head_width", HEAD_WIDTHS.get(width, 64))
    text_heads = config.get("text_cfg", {}).get("heads", max(1, text_width // 64))
    joint = shape["visual.proj"][1]
    common = {
        "hidden_act": "quick_gelu" if config.get("quick_gelu") else "gelu",
        "projection_dim": joint,
    }
    vision, text = (
        {
            "hidden_size": channels,
            "num_hidden_layers": layers[tower],
            "num_attention_heads": heads,
            "intermediate_size": shape[f"{tower}.resblocks.0.mlp.c_fc.weight"][0],
            **common,
        }
        for tower, channels, heads in zip(
            TOWERS, (width, text_width), (max(1, width // head), text_heads), strict=True
        )
    )
    vision["patch_size"] = patch
    vision["image_size"] = patch * math.isqrt(shape["visual.positional_embedding"][0] - 1)
    text["vocab_size"] = vocabulary
    text["max_position_embeddings"] = shape["positional_embedding"][0]
    text |= {"bos_token_id": vocabulary - 2, "eos_token_id": vocabulary - 1}
    return {"projection_dim": joint, "vision_config": vision, "text_config": text}


def _read_config(file: Path) -> Mapping[str, Any]:
    config = table_in(read_json(file), "model_cfg", file)
    for table, supported in UNDERSTOOD.items():
        section = table_in(config, table, file) if table else config
        for key, value in section.items():
            if key not in supported and value:
                name = f"{table}.{key}" if table else key
                raise InputError(
                    f"{file}: {name} is {value!r}, but models with it cannot be converted; give "
                    "one with a plain ViT and text transformer, such as ViT-B-16"
                )
            if key in ("head_width", "heads") and (type(value) is not int or value < 1):
                raise InputError(
                    f"{file}: {table}.{key} is {value!r:.60}, expected a whole number from 1 on; "
                    "get it again"
                )
    return config


def _read_tensors(file: Path) -> dict[str, torch.Tensor]:
    """Read the tensors of a checkpoint by name, without running code of the file."""
    try:
        if file.suffix == ".safetensors":
            from safetensors.torch import load_file

            content: Any = load_file(file)
        else:
            content = tensorfile.load(file)
    except Exception as problem:  # a damaged file raises almost anything
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"model {file}: cannot be read as weights ({reason}); expected a .safetensors file, or "
            "one of torch.save with nothing but tensors"
        ) from None
    if isinstance(content, dict) and isinstance(content.get("state_dict"), dict):
        content = content["state_dict"]
    if not isinstance(content, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor)
        for name, tensor in content.items()
    ):
        raise InputError(f"model {file}: holds other things than tensors by name; get it again")
    # DistributedDataParallel prefixes all names.
    return {name.removeprefix("module."): tensor for name, tensor in content.items()}
