"""The rasteriser, MVSplat and training on a CUDA GPU, compared with the CPU.

    python -m benches.rasterize.on_gpu [-o docs/measured]

Needs a CUDA device and gsplat. Scenes are procedural, MVSplat's weights random.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benches.common.harness import error, ms, parser, publish, table, times_in_turn
from benches.common.photograph_pairs import load_samples
from benches.predict.random_mvsplat_weights import recipe_weights
from benches.rasterize.speed_and_error import Subject, both_ways, random_values
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import threads
from slgaussian.predict import load_predictor
from slgaussian.semantic.training import TrainingSettings, train
from tests.semantic.drawn_lessons import lesson

CHANNELS = (3, 64)
PRECISIONS = ("float32", "bfloat16")
STEPS = 12


def synchronise(work: Callable[[], object]) -> Callable[[], None]:
    """Return a call of ``work`` that ends when the GPU has finished."""

    def call() -> None:
        work()
        torch.cuda.synchronize()

    return call


def on_gpu(subject: Subject) -> Subject:
    tensors = {name: value.cuda() for name, value in subject.gaussians.items()}
    return replace(subject, gaussians=Gaussians(**tensors), values=subject.values.cuda())


def rasterizer_rows() -> list[dict[str, Any]]:
    (sample,) = load_samples(None).values()
    scene = Subject.of("procedural", sample)
    rows = []
    for channels in CHANNELS:
        cpu = replace(scene, values=random_values(len(scene.gaussians), channels))
        gpu = on_gpu(cpu)
        spent = times_in_turn(
            {
                "cpu": cpu.draw,
                "gpu": synchronise(lambda gpu=gpu: gpu.draw(backend="cuda")),
                "cpu_both": both_ways(cpu),
                "gpu_both": synchronise(both_ways(gpu)),
            }
        )
        off = (gpu.draw(backend="cuda").cpu() - cpu.draw()).abs()
        row = {"gaussians": len(cpu.gaussians), "channels": channels, **spent}
        rows.append(row | {"mean": float(off.mean()), "greatest": float(off.max())})
    return rows


def mvsplat_rows(folder: Path) -> list[dict[str, Any]]:
    (sample,) = load_samples(None, (256, 256)).values()
    checkpoint = str(folder / "recipe.ckpt")
    torch.save(recipe_weights(), checkpoint)
    rows: list[dict[str, Any]] = []
    exact = None
    for precision in PRECISIONS:
        predict = {
            device: load_predictor(
                "mvsplat", checkpoint=checkpoint, precision=precision, device=device
            )
            for device in ("cpu", "cuda")
        }
        spent = times_in_turn(
            {device: lambda load=load: load(sample) for device, load in predict.items()}
        )
        depths = {d: p(sample).means.double().norm(dim=1) for d, p in predict.items()}
        exact = depths["cpu"] if exact is None else exact
        for device, depth in depths.items():
            off = (depth / exact - 1).abs()
            row = {"what": f"{device}, {precision}", "seconds": spent[device]}
            rows.append(row | {"mean": float(off.mean()), "greatest": float(off.max())})
    return rows


def training_rows(folder: Path) -> list[dict[str, Any]]:
    lessons = [lesson(seed, (240, 320)) for seed in range(3)]
    losses: dict[str, np.ndarray] = {}

    def training(device: str) -> Callable[[], None]:
        settings = TrainingSettings(steps=STEPS, every=STEPS, device=device)

        def call() -> None:
            with tempfile.TemporaryDirectory(dir=folder) as place:
                losses[device] = train(lessons, settings, Path(place)).metrics["loss"].to_numpy()

        return call

    spent = times_in_turn({device: training(device) for device in ("cpu", "cuda")})
    return [
        {
            "what": device,
            "seconds": seconds / STEPS,
            "greatest": float(np.abs(losses[device] / losses["cpu"] - 1).max()),
        }
        for device, seconds in spent.items()
    ]


def main() -> None:
    args = parser(__doc__, "rasterizer.md").parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("error: found no CUDA device, which this bench compares with the CPU")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        errors = {"mean": ("error: mean", error), "greatest": ("greatest", error)}
        speed = {
            "gaussians": ("Gaussians", ",d"),
            "channels": ("channels", "d"),
            "cpu": ("cpu, ms", ms),
            "gpu": ("cuda, ms", ms),
            "cpu_both": ("back and forth: cpu, ms", ms),
            "gpu_both": ("cuda, ms", ms),
        }
        steps = {"what": ("training", str), "seconds": ("a step, ms", ms)}
        publish(
            args.out,
            "rasterizer.md",
            "python -m benches.rasterize.on_gpu",
            f"GPU: {torch.cuda.get_device_name()}.",
            table(rasterizer_rows(), speed | errors),
            table(mvsplat_rows(folder), {"what": ("MVSplat", str), "seconds": ("ms", ms)} | errors),
            table(training_rows(folder), steps | {"greatest": ("loss: greatest error", error)}),
        )


if __name__ == "__main__":
    threads.limit()
    main()
