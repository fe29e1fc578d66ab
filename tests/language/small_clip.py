"""A small CLIP with random weights, large enough that texts differ, and its tokenizer."""

import json
from pathlib import Path

import torch
import transformers

SIDE = 32
"""Of the pictures that the network looks at."""

WIDTH = 24
"""Axes of the space that regions and texts share."""

WORDS = ("red", "blue", "ball", "box", "basket", "object", "things", "stuff", "texture")


def byte_letters() -> list[str]:
    """The letter that stands for each byte in byte-level vocabularies."""
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    spare = iter(range(256, 512))
    return [chr(b if b in printable else next(spare)) for b in range(256)]


def save_tokenizer(folder: Path) -> int:
    """Write vocab.json and merges.txt; returns the number of tokens, of which the last ends texts.

    As in CLIP's own vocabulary: bytes, bytes that end a word, merges, and the two marks.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tokens = byte_letters()
    tokens += [letter + "</w>" for letter in tokens]
    merges = []
    for word in WORDS:
        parts = [*word[:-1], word[-1] + "</w>"]
        while len(parts) > 1:
            left, right, *rest = parts
            if (left, right) not in merges:
                merges.append((left, right))
                tokens.append(left + right)
            parts = [left + right, *rest]
    tokens += ["<|startoftext|>", "<|endoftext|>"]
    vocabulary = {token: i for i, token in enumerate(dict.fromkeys(tokens))}
    (folder / "vocab.json").write_text(json.dumps(vocabulary))
    lines = ["#version: 0.2", *(" ".join(pair) for pair in merges)]
    (folder / "merges.txt").write_text("\n".join(lines) + "\n", "utf-8")
    return len(vocabulary)


def clip_model(tokens: int, activation: str = "gelu", **vision) -> transformers.CLIPModel:
    common = {"hidden_act": activation, "projection_dim": WIDTH}
    config = transformers.CLIPConfig.from_dict(
        {
            "projection_dim": WIDTH,
            "vision_config": {
                "hidden_size": 128,
                "intermediate_size": 96,
                "num_hidden_layers": 2,
                "num_attention_heads": 2,
                "image_size": SIDE,
                "patch_size": 8,
                **common,
                **vision,
            },
            "text_config": {
                "hidden_size": 64,
                "intermediate_size": 80,
                "num_hidden_layers": 3,
                "num_attention_heads": 1,
                "vocab_size": tokens,
                "max_position_embeddings": 77,
                "bos_token_id": tokens - 2,
                "eos_token_id": tokens - 1,
                **common,
            },
        }
    )
    torch.manual_seed(0)
    model = transformers.CLIPModel(config).eval().requires_grad_(False)
    state = torch.Generator().manual_seed(1)
    for name, tensor in sorted(model.named_parameters()):
        if tensor.ndim > 1:
            spread = 1.0 if "embedding.weight" in name else 1.5 * tensor[0].numel() ** -0.5
            tensor.copy_(torch.randn(tensor.shape, generator=state) * spread)
        elif tensor.ndim == 1:
            tensor.add_(0.1 * torch.randn(tensor.shape, generator=state))
    return model


def save_clip(folder: Path, **sizes) -> Path:
    """A folder as ``save_pretrained`` writes it, tokenizer included."""
    clip_model(save_tokenizer(folder), **sizes).save_pretrained(folder)
    return folder
