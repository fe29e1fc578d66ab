"""Speed, memory and error of MVSplat's settings.

``python benches/mvsplat.py [CHECKPOINT]``: two views of 416 x 576, each setting in a process of its
own. Errors are against float32 with all candidates: of the distance from the camera as a share of
it, of opacity and degree-0 colour as they are. Without a checkpoint the weights are made by a
recipe: times and memory are those of published ones, errors are not.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np
import torch

from slgaussian import datasets
from slgaussian.predict import load_predictor
from slgaussian.predict.mvsplat.network import Network

SIZE = (416, 576)
REPEATS = 3
SETTINGS = {
    "float32": {},
    "float32, 64 candidates": {"depth_candidates": 64},
    "float32, 32 candidates": {"depth_candidates": 32},
    "float32, auto candidates": {"depth_candidates": "auto"},
    "bfloat16": {"precision": "bfloat16"},
    "bfloat16, auto candidates": {"precision": "bfloat16", "depth_candidates": "auto"},
}

GAIN = {
    "depth_predictor.regressor_residual.weight": 0.02,
    "depth_predictor.depth_head_lowres.2.weight": 0.5,
    "depth_predictor.to_disparity.2.weight": 0.1,
    "depth_predictor.to_disparity.2.bias": 0.1,
}
"""Factors that bring the recipe's outputs into the range of trained ones."""


def recipe_weights() -> dict[str, torch.Tensor]:
    """Weights by name, float32, the same everywhere: each from its own name as the seed.

    Unlike freshly initialised ones, none is zero, so that every layer has a say.
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


def measure(checkpoint: str, out: str, settings: str) -> None:
    """Print seconds and peak memory of one setting; leave its numbers in ``out``."""
    scene = datasets.load("procedural", seed=0, height=SIZE[0], width=SIZE[1])
    names = list(scene.cameras)
    sample = scene.sample([names[0], names[-1]], near=1.0, far=100.0)
    start = time.perf_counter()
    predict = load_predictor("mvsplat", checkpoint=checkpoint, **json.loads(settings))
    loading = time.perf_counter() - start
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        gaussians = predict(sample)
        seconds.append(time.perf_counter() - start)
    centres = np.stack([view.camera.center for view in sample.context])
    means = gaussians.means.numpy().reshape(2, -1, 3)
    depth = np.linalg.norm(means - centres[:, None], axis=-1).ravel()
    colors, opacities = gaussians.colors().numpy(), gaussians.opacities.numpy()
    np.savez(out, depth=depth, colors=colors, opacities=opacities)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(json.dumps({"load": loading, "seconds": min(seconds), "GiB": peak}))


def main(checkpoint: str | None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        if checkpoint is None:
            print("No checkpoint given: weights by a recipe, whose errors say little of real ones.")
            checkpoint = str(Path(folder) / "recipe.ckpt")
            torch.save(recipe_weights(), checkpoint)
        print(f"{torch.get_num_threads()} threads; best of {REPEATS}\n")
        print(
            "| setting | load s | s | peak GiB | depth: mean | max | opacity: max | colour: max |"
        )
        print("|---|--:|--:|--:|--:|--:|--:|--:|")
        first = None
        for name, settings in SETTINGS.items():
            out = str(Path(folder) / "out.npz")
            command = [sys.executable, __file__, "--one", checkpoint, out, json.dumps(settings)]
            done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
            row, found = json.loads(done.stdout), dict(np.load(out))
            first = first or found
            depth = np.abs(found["depth"] / first["depth"] - 1)
            others = [np.abs(found[key] - first[key]).max() for key in ("opacities", "colors")]
            errors = " | ".join(f"{e:.1e}" for e in (depth.mean(), depth.max(), *others))
            times = f"{row['load']:.2f} | {row['seconds']:.2f} | {row['GiB']:.2f}"
            print(f"| {name} | {times} | {errors} |", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        measure(*sys.argv[2:])
    else:
        main(*(sys.argv[1:] or [None]))
