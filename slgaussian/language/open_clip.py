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
from safetensors.torch import load_file

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

SUPPORTED_KEYS = {
    "embed_dim", "vision_cfg", "text_cfg", "quick_gelu", "image_size", "layers", "width",
    "patch_size", "head_width", "mlp_ratio", "patch_dropout", "context_length", "vocab_size",
    "heads",
}  # fmt: skip
"""Supported configuration keys, including those that only training uses. Any other key with a value
that is neither empty nor false is a feature that CLIPModel lacks."""

LAYER_PATTERN = re.compile(r"(visual\.)?transformer\.resblocks\.(\d+)\.(.+)[._](weight|bias)")
LAYER_NAMES = {
    "ln_1": "layer_norm1",
    "ln_2": "layer_norm2",
    "attn.in_proj": "self_attn.{}_proj",
    "attn.out_proj": "self_attn.out_proj",
    "mlp.c_fc": "mlp.fc1",
    "mlp.c_proj": "mlp.fc2",
}
"""Names within a layer; {} stands for each of q, k and v."""

TENSOR_NAMES = {
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
}
OPENAI_SIZES = {"input_resolution", "context_length", "vocab_size"}
"""Scalar tensors that only OpenAI's own checkpoints have; all of these use QuickGELU."""

TRANSPOSED_TENSORS = ("visual.proj", "text_projection")


def load_open_clip(files: ModelFiles) -> Any:
    """Load a checkpoint as a float32 ``CLIPModel``.

    Args:
        files: Files with a checkpoint: ``.safetensors``, or a ``torch.save`` file that holds only
            tensors, at top level or under ``state_dict``.

    Raises:
        InputError: If the file cannot be read, its tensors are not those of a CLIPModel, or the
            configuration has a feature that CLIPModel lacks.
    """
    config: Mapping[str, Any] = {}
    for file in files.files:
        if file.name == OPEN_CLIP_CONFIG:
            config = dict(table_in(read_json(file), "model_cfg", file))
            config |= {key: table_in(config, key, file) for key in ("vision_cfg", "text_cfg")}
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
    vision, text = config.get("vision_cfg", {}), config.get("text_cfg", {})
    for key, value in {**config, **vision, **text}.items():
        if value and key not in SUPPORTED_KEYS:
            raise InputError(
                f"model {source}: its {OPEN_CLIP_CONFIG} has {key} {value!r:.60}, and models with "
                "it cannot be converted; give one with a plain ViT and text transformer, such as "
                "ViT-B-16"
            )
    renamed: dict[str, torch.Tensor] = {}
    for name, tensor in tensors.items():
        ours = _name(name)
        if "{}" in ours:
            for letter, part in zip("qkv", tensor.float().chunk(3), strict=True):
                renamed[ours.format(letter)] = part.clone()
        else:
            renamed[ours] = (
                (tensor.T if name in TRANSPOSED_TENSORS else tensor).contiguous().float()
            )
    try:
        renamed["logit_scale"] = renamed["logit_scale"].reshape(())
        with quiet_transformers():
            network, report = CLIPModel.from_pretrained(
                None,
                config=CLIPConfig.from_dict(_sizes(tensors, config)),
                state_dict=renamed,
                dtype=torch.float32,
                output_loading_info=True,
            )
        for problem in ("missing_keys", "unexpected_keys"):
            if report[problem]:
                raise ValueError(f"{problem.replace('_', ' ')} such as {min(report[problem])}")
    except Exception as problem:  # layers raise exceptions of any type
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"model {source}: its tensors are not those of a ViT and a text transformer of "
            f"open_clip, such as ViT-B-16 ({reason}); give another checkpoint"
        ) from None
    return network


def _name(theirs: str) -> str:
    """Return the name in ``transformers`` of a tensor of open_clip; unknown names stay."""
    match = LAYER_PATTERN.fullmatch(theirs)
    if match is None or match[3] not in LAYER_NAMES:
        return TENSOR_NAMES.get(theirs, theirs)
    tower = "vision_model" if match[1] else "text_model"
    return f"{tower}.encoder.layers.{match[2]}.{LAYER_NAMES[match[3]]}.{match[4]}"


def _sizes(tensors: Mapping[str, torch.Tensor], config: Mapping[str, Any]) -> dict[str, Any]:
    """Infer the configuration of CLIPModel."""
    width, _, patch, _ = tensors["visual.conv1.weight"].shape
    vocabulary, text_width = tensors["token_embedding.weight"].shape
    head = config.get("vision_cfg", {}).get("head_width", HEAD_WIDTHS.get(width, 64))
    text_heads = config.get("text_cfg", {}).get("heads", max(1, text_width // 64))
    joint = tensors["visual.proj"].shape[1]

    def tower(prefix: str, channels: int, heads: int) -> dict[str, Any]:
        layer = re.compile(rf"{prefix}\.resblocks\.\d+\.ln_1\.weight")
        return {
            "hidden_size": channels,
            "num_hidden_layers": sum(layer.fullmatch(name) is not None for name in tensors),
            "num_attention_heads": heads,
            "intermediate_size": len(tensors[f"{prefix}.resblocks.0.mlp.c_fc.weight"]),
            "hidden_act": "quick_gelu" if config.get("quick_gelu") else "gelu",
            "projection_dim": joint,
        }

    vision = tower("visual.transformer", width, max(1, width // head)) | {
        "patch_size": patch,
        "image_size": patch * math.isqrt(len(tensors["visual.positional_embedding"]) - 1),
    }
    text = tower("transformer", text_width, text_heads) | {
        "vocab_size": vocabulary,
        "max_position_embeddings": len(tensors["positional_embedding"]),
        "bos_token_id": vocabulary - 2,
        "eos_token_id": vocabulary - 1,
    }
    return {"projection_dim": joint, "vision_config": vision, "text_config": text}


def _read_tensors(file: Path) -> dict[str, torch.Tensor]:
    """Read the tensors of a checkpoint by name, without running code of the file."""
    try:
        weights: Any = load_file(file) if file.suffix == ".safetensors" else tensorfile.load(file)
        weights = weights.get("state_dict", weights)
        # DistributedDataParallel prefixes all names.
        return {name.removeprefix("module."): tensor.detach() for name, tensor in weights.items()}
    except Exception as problem:  # a damaged file raises almost anything
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise InputError(
            f"model {file}: cannot be read as weights ({reason}); expected a .safetensors file, or "
            "one of torch.save with nothing but tensors"
        ) from None
