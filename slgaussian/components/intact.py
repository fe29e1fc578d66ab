"""Checks of a component's files, by the hub's digests or by loading and testing the component.

Models answer questions on pictures of scikit-image; random weights have hardly any answer right.
This has not been tried with published weights, so no component is refused for its answers.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import skimage.data
from scipy import ndimage, stats
from skimage.filters import sobel
from skimage.segmentation import watershed

from slgaussian.components.component import Component
from slgaussian.components.pretrained import (
    find_model,
    find_tokenizer,
    model_digest,
    tokenizer_digest,
)
from slgaussian.components.registry import find_config
from slgaussian.errors import InputError

SHA256 = re.compile("[0-9a-f]{64}")
AGAIN = "get it again"

PICTURES = {
    "chelsea": "a photo of a cat",
    "coffee": "a photo of a cup of coffee",
    "rocket": "a photo of a rocket",
    "astronaut": "a photo of an astronaut",
}
"""Captions of pictures of scikit-image."""

ALIKE = 0.7
"""Smallest IoU of a correct mask of a coin."""

SHIFT = 6
"""Displacement of the coins between frames, in pixels to the right."""


def check_component(kind: str, name: str, values: Mapping[str, Any]) -> str:
    """Check the files of a component without downloading anything.

    Weights in the hub's cache are compared with the hub's digests. Models are loaded, which checks
    their configuration and the names and shapes of tensors; their weights must be finite, and they
    answer the questions of :data:`KNOWN`.

    Args:
        kind, name: Arguments of :func:`slgaussian.components.registry.find_config`.
        values: Fields of the component.

    Returns:
        str: A sentence about the files; empty for a component without files.

    Raises:
        InputError: If a file is missing, damaged, or not what the component needs.
    """
    files, verified = find_config(kind, name).files(), list[bool]()
    places = {key: values[key] for key in files if values.get(key) is not None}
    for key, place in places.items():
        if files[key].digest is model_digest:
            weights = find_model(place, download=False).files
            verified += [is_of_hub(file) for file in weights if file.suffix != ".json"]
        elif files[key].digest is tokenizer_digest:
            find_tokenizer(place, download=False)
    part = Component.of(kind, name, values).load()
    label = ", ".join(f"{key} {place}" for key, place in places.items())
    if (network := getattr(part, "network", None)) is not None:
        for tensor_name, tensor in network.named_parameters():
            if not tensor.isfinite().all():
                raise InputError(f"{label}: {tensor_name} holds NaN or infinity; {AGAIN}")
    if not label:
        return ""
    known = verified and all(verified)
    facts = ["is what the hub has, by its SHA-256" if known else "can be loaded and used"]
    if kind in KNOWN and {"model", "checkpoint"} & files.keys():
        facts.append(KNOWN[kind](part))
    return f"{label}: {', '.join(facts)}"


def is_of_hub(file: Path) -> bool:
    """Return whether a file is in the hub's cache and its content has the cached SHA-256.

    Raises:
        InputError: If its content has another SHA-256, or it cannot be read.
    """
    stored = file.resolve()
    if not SHA256.fullmatch(stored.name):
        return False
    try:
        with file.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); {AGAIN}") from error
    if stored.name != digest:
        raise InputError(
            f"{file}: is damaged: its SHA-256 begins with {digest[:8]}, and of the file on the hub "
            f"with {stored.name[:8]}; delete {stored} and {AGAIN}"
        )
    return True


def name_pictures(encoder: Any) -> str:
    """Count the :data:`PICTURES` whose caption is the most similar of all captions."""
    texts, right = encoder.encode_text(list(PICTURES.values())), 0
    for number, name in enumerate(PICTURES):
        image = getattr(skimage.data, name)()
        vector = encoder.encode_regions(image, np.ones((1, *image.shape[:2]), bool))[0]
        right += int((texts @ vector).argmax()) == number
    return f"names {right} of {len(PICTURES)} pictures (trained: all)"


def find_coins(proposer: Any) -> str:
    """Count the coins whose mask results from a point prompt at the centre."""
    import torch

    image, coins = coin_picture()
    masks = [coins == number for number in range(1, coins.max() + 1)]
    middles = np.array(ndimage.center_of_mass(coins > 0, coins, range(1, coins.max() + 1)))
    encoded, right = proposer.encode(image), 0
    with torch.inference_mode():
        for mask, middle in zip(masks, middles, strict=True):
            logits = encoded.segment(middle[None, ::-1] + 0.5)[0][0]
            proposed = encoded.enlarge(logits).cpu().numpy() > 0
            right += max(_iou(candidate, mask) for candidate in proposed) >= ALIKE
    return f"finds {right} of {len(masks)} coins (trained: nearly all)"


def follow_coins(tracker: Any) -> str:
    """Count the coins that are tracked correctly to a shifted frame."""
    from slgaussian.geometry import SeenView
    from slgaussian.scene import Camera, View

    image, coins = coin_picture()
    height, width = coins.shape
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    camera = Camera(K, np.eye(4), width, height)
    tracker.add(SeenView(View("first", camera, image)), coins)
    propagated = tracker.propagate(SeenView(View("second", camera, np.roll(image, SHIFT, 1))))
    moved = np.roll(coins, SHIFT, 1)
    right = sum(_iou(propagated == n, moved == n) >= ALIKE for n in range(1, coins.max() + 1))
    return f"follows {right} of {coins.max()} coins (trained: nearly all)"


def order_depths(predictor: Any) -> str:
    """Compute the rank correlation of predicted and true depth in the motorcycle pair."""
    from slgaussian.datasets import stereo
    from slgaussian.geometry import SceneGeometry

    sample = stereo.read().sample(["left", "right"], size=(256, 352), near=1.5, far=8.0)
    seen = SceneGeometry.of(sample.context, predictor(sample)).frames[0]
    depth, truth = seen.require_depth(), sample.context[0].depth
    assert truth is not None  # the left view has it
    measured = (depth > 0) & (truth > 0)
    order = stats.spearmanr(depth[measured], truth[measured]).statistic if measured.any() else 0.0
    return f"orders depths of a motorcycle by {order:.2f} of 1 (planesweep: 0.94)"


KNOWN: dict[str, Callable[[Any], str]] = {
    "encoder": name_pictures,
    "proposer": find_coins,
    "tracker": follow_coins,
    "predictor": order_depths,
}
"""Test of components with pretrained weights, by kind."""


def coin_picture() -> tuple[np.ndarray, np.ndarray]:
    """Return coins on a table, uint8 [H, W, 3], and the number of the coin at each pixel."""
    grey = skimage.data.coins()
    markers = np.where(grey < 30, 1, np.where(grey > 150, 2, 0))
    filled = ndimage.binary_fill_holes(watershed(sobel(grey), markers) == 2)
    labels, _ = ndimage.label(ndimage.binary_opening(filled, iterations=3))
    return np.repeat(grey[..., None], 3, -1), labels.astype(np.int32)


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))
