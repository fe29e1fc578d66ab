"""Reproducible random weights for MVSplat, to test it without the published ones.

``python -m benches.predict.random_mvsplat_weights recipe.ckpt`` writes them as a checkpoint. Their
scenes are noise; shapes, times and memory are those of ``re10k.ckpt``.
"""

import sys
import zlib

import numpy as np
import torch

from slgaussian.predict.mvsplat.network import Network

GAIN = {
    "depth_predictor.regressor_residual.weight": 0.02,
    "depth_predictor.depth_head_lowres.2.weight": 0.5,
    "depth_predictor.to_disparity.2.weight": 0.1,
    "depth_predictor.to_disparity.2.bias": 0.1,
}
"""Factors that scale the outputs of these weights to the range of trained ones."""


def recipe_weights() -> dict[str, torch.Tensor]:
    """Return reproducible weights by name, float32, each seeded by its name.

    No weight is zero, so that every layer affects the result.
    """
    with torch.device("meta"):
        shapes = {name: tuple(t.shape) for name, t in Network().state_dict().items()}
    return {name: torch.from_numpy(_values(name, shape)) for name, shape in shapes.items()}


def _values(name: str, shape: tuple[int, ...]) -> np.ndarray:
    normal = np.random.default_rng(zlib.crc32(name.encode())).standard_normal(shape)
    if len(shape) >= 2:
        values = normal / np.sqrt(np.prod(shape[1:]))
    else:
        values = 0.1 * normal + name.endswith("weight")
    return (values * GAIN.get(name, 1)).astype(np.float32)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(
            "give the file to write: python -m benches.predict.random_mvsplat_weights recipe.ckpt"
        )
    torch.save(recipe_weights(), sys.argv[1])
