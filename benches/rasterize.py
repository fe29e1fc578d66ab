"""Speed and error of the rasteriser: run ``python benches/rasterize.py [DATA]``.

Without DATA the scene is a procedural pair; with it, the pairs of DATA, a nerfstudio folder with
``pairs.json``. Times are medians over rounds in which every contender draws once, among them the
plain loop of ``yardstick.py``; errors are the largest of any channel against the float64 reference,
on windows of the same views. The hard cases have a table of their own: ``python -m
benches.hard_cases``.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from yardstick import splat_in_order

import slgaussian.threads
from slgaussian import datasets
from slgaussian.gaussians import Gaussians
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import Settings, rasterize
from slgaussian.scene import Camera, Sample

SIZE = (416, 576)
ROUNDS = 11
WINDOWS = ((200, 150), (400, 300))
SETTINGS = {
    "fast": Settings(),
    "alpha_min 1/512": Settings(alpha_min=1 / 512),
    "alpha_min 1/4096": Settings(alpha_min=1 / 4096, pass_min=1e-4),
    "3dgs cut-offs": Settings(alpha_min=1 / 255, sigmas=3, pass_min=1e-4),
}


def samples(folder: Path | None) -> dict[str, Sample]:
    if folder is None:
        scene = datasets.load("procedural", seed=0, height=SIZE[0], width=SIZE[1])
        names = list(scene.cameras)
        return {"procedural": scene.sample([names[0], names[-1]], names[1:2])}
    scene = datasets.load("nerfstudio", folder)
    pairs = json.loads((folder / "pairs.json").read_text())
    return {
        name: scene.sample(pair["context"], pair["target"][:1], size=SIZE)
        for name, pair in pairs.items()
    }


def carried(gaussians: Gaussians) -> torch.Tensor:
    """Colour and three numbers as different from neighbour to neighbour as codes can be."""
    codes = torch.rand(len(gaussians), 3, generator=torch.Generator().manual_seed(0))
    return torch.cat([gaussians.colors(), codes], 1)


def race(contenders: dict) -> dict[str, float]:
    """Median seconds of each, drawn in turn so that a busy machine is busy for all."""
    spent = {name: [] for name in contenders}
    for draw in contenders.values():
        draw()
    for _ in range(ROUNDS):
        for name, draw in contenders.items():
            start = time.perf_counter()
            draw()
            spent[name].append(time.perf_counter() - start)
    return {name: float(np.median(seconds)) for name, seconds in spent.items()}


def speed(gaussians: Gaussians, values: torch.Tensor, camera: Camera) -> None:
    arrays, plain = gaussians.to_arrays(), values.numpy()
    names = ("means", "scales", "quats", "opacities")
    leaves = [getattr(gaussians, name).clone().requires_grad_() for name in names]
    free, free_values = replace(gaussians, **dict(zip(names, leaves, strict=True))), values.clone()
    free_values.requires_grad_()
    upstream = torch.rand(camera.height, camera.width, values.shape[1])

    def both_ways() -> None:
        drawn = rasterize(free, free_values, camera)
        torch.autograd.grad(drawn.values, [*leaves, free_values], upstream)

    contenders = {"plain loop": lambda: splat_in_order(arrays, plain, camera)}
    for name, settings in SETTINGS.items():
        contenders[name] = lambda settings=settings: rasterize(
            gaussians, values, camera, settings=settings
        )
    contenders["forward and backward"] = both_ways
    seconds = race(contenders)
    for name, spent in seconds.items():
        ratio = seconds["plain loop"] / spent
        print(f"  {name:22s} {1e3 * spent:7.1f} ms   loop / this {ratio:5.2f}")


def errors(gaussians: Gaussians, values: torch.Tensor, camera: Camera) -> dict[str, float]:
    worst = dict.fromkeys(SETTINGS, 0.0)
    for left, top in WINDOWS:
        window = camera.cropped(left, top, 40, 32)
        true = rasterize(gaussians, values, window, backend="reference").values
        for name, settings in SETTINGS.items():
            drawn = rasterize(gaussians, values, window, settings=settings).values
            worst[name] = max(worst[name], float((drawn - true).abs().max()))
    return worst


if __name__ == "__main__":
    slgaussian.threads.share()
    for name, sample in samples(Path(sys.argv[1]) if len(sys.argv) > 1 else None).items():
        gaussians = PlaneSweep()(sample)
        values, camera = carried(gaussians), sample.targets[0].camera
        print(f"{name}: {len(gaussians)} Gaussians, {values.shape[1]} channels")
        speed(gaussians, values, camera)
        cells = (
            f"{label} {error:.5f}" for label, error in errors(gaussians, values, camera).items()
        )
        print("  largest error:", ", ".join(cells), flush=True)
