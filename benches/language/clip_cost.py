"""Time, error and repeatability of the encoder ``clip`` on a ViT-B/16 with random weights.

python -m benches.language.clip_cost

Milliseconds of one core a region (16 of them in a 416x576 image) or a text of 8 tokens; the largest
difference of any cosine between a region and a text from that of the same network in float64; and
whether vectors have the same bytes in another order and with two threads.
"""

import copy
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
import transformers
from tokenizers.pre_tokenizers import ByteLevel

from benches.common.pages import page
from slgaussian.language.clip import Clip

ROUNDS = 3
TEXTS = [chr(97 + i) * 6 for i in range(16)]


def save_model(folder: Path) -> Path:
    tokens = ByteLevel.alphabet()
    tokens = [*tokens, *(t + "</w>" for t in tokens), "<|startoftext|>", "<|endoftext|>"]
    (folder / "vocab.json").write_text(json.dumps({t: i for i, t in enumerate(tokens)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    last = len(tokens) - 1
    vision = {"hidden_size": 768, "intermediate_size": 3072, "num_attention_heads": 12}
    text = {"vocab_size": len(tokens), "bos_token_id": last - 1, "eos_token_id": last}
    towers = {"vision_config": {**vision, "patch_size": 16}, "text_config": text}
    for tower in towers.values():
        tower["hidden_act"] = "gelu"
    torch.manual_seed(0)
    config = transformers.CLIPConfig.from_dict({"projection_dim": 512, **towers})
    transformers.CLIPModel(config).save_pretrained(folder)
    return folder


def scene() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (13, 18, 3), np.uint8).repeat(32, 0).repeat(32, 1)
    y, x = np.mgrid[:416, :576]
    centres = rng.uniform(0, 1, (16, 2)) * (576, 416)
    return image, np.array(
        [np.hypot(x - a, y - b) < 30 + 8 * i for i, (a, b) in enumerate(centres)]
    )


def least(call) -> float:
    seconds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        call()
        seconds.append(time.process_time() - start)
    return min(seconds)


def in_float64(clip: Clip) -> Clip:
    """The same encoder with another network."""
    exact = copy.copy(clip)
    network = copy.deepcopy(clip.network).double()
    pictures = network.get_image_features
    network.get_image_features = lambda values: pictures(values.double())
    object.__setattr__(exact, "network", network)
    return exact


def measure(folder: Path) -> list[dict]:
    image, masks = scene()
    plain = Clip(model=folder)
    exact = {
        crops: in_float64(Clip(model=folder, crops=crops)).encode_regions(image, masks)
        for crops in ("masked", "context")
    }
    words = in_float64(plain).encode_text(TEXTS)
    rows = []
    for settings in (
        {"batch": 1},
        {"batch": 4},
        {"batch": 16},
        {"batch": 4, "crops": "context"},
        {"batch": 4, "precision": "bfloat16"},
    ):
        clip = Clip(model=folder, **settings)
        torch.set_num_threads(1)
        found = clip.encode_regions(image, masks)
        order = np.array_equal(clip.encode_regions(image, masks[::-1])[::-1], found)
        seconds = least(lambda clip=clip: clip.encode_regions(image, masks)) / len(masks)
        torch.set_num_threads(2)
        threads = np.array_equal(clip.encode_regions(image, masks), found)
        away = np.abs((found - exact[clip.crops]) @ words.T).max()
        said = ", ".join(f"{name} {value}" for name, value in settings.items())
        rows.append(row(f"region, {said}", seconds, away, order, threads))
    torch.set_num_threads(1)
    found = plain.encode_text(TEXTS)
    order = np.array_equal(plain.encode_text(TEXTS[::-1])[::-1], found)
    seconds = least(lambda: plain.encode_text(TEXTS)) / len(TEXTS)
    torch.set_num_threads(2)
    threads = np.array_equal(plain.encode_text(TEXTS), found)
    away = np.abs((found - words) @ exact["masked"].T).max()
    return [*rows, row("text", seconds, away, order, threads)]


def row(what: str, seconds: float, away: float, order: bool, threads: bool) -> dict:
    same = {True: "yes", False: "no"}
    return {
        "what": what,
        "seconds": seconds,
        "difference": float(away),
        "order": same[order],
        "threads": same[threads],
    }


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        print(page("language/clip_cost.md.j2", rows=measure(save_model(Path(place)))))


if __name__ == "__main__":
    main()
