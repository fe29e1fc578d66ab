"""Speed, memory and error of MVSplat's settings.

    python -m benches.predict.mvsplat_cost [CHECKPOINT] [-o docs/measured]

Without CHECKPOINT weights are random.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from benches.common.harness import error, parser, publish, table
from benches.common.photograph_pairs import SIZE
from benches.common.resident_memory import memory_status
from benches.predict.random_mvsplat_weights import recipe_weights
from slgaussian import datasets
from slgaussian.cameras.paths import between
from slgaussian.kernels import threads
from slgaussian.predict import load_predictor
from slgaussian.rasterize import rasterize

ROUNDS = 3
PRECISIONS = ("float32", "bfloat16")
TIMES = ("load", "seconds", "cpu")


def measure(checkpoint: str, precision: str, out: str) -> None:
    """Print times and peak memory of one prediction as JSON; write the prediction to ``out``."""
    scene = datasets.load("procedural", seed=0, height=SIZE[0], width=SIZE[1])
    names = list(scene.cameras)
    sample = scene.sample([names[0], names[-1]], near=1.0, far=100.0)
    start = time.perf_counter()
    predict = load_predictor("mvsplat", checkpoint=checkpoint, precision=precision)
    row = {"load": time.perf_counter() - start, "precision": precision}
    cameras = [view.camera for view in sample.context]
    predict(sample.resized(64, 96))
    start = time.perf_counter(), time.process_time()
    gaussians = predict(sample)
    row |= {"seconds": time.perf_counter() - start[0], "cpu": time.process_time() - start[1]}
    row["peak"] = memory_status("VmHWM") / 1e6
    means = gaussians.means.numpy().reshape(2, -1, 3)
    centres = np.stack([camera.center for camera in cameras])
    distance = np.linalg.norm(means - centres[:, None], axis=-1)
    pixel = rasterize(gaussians, None, between(*cameras, 0.5)).values.clamp(0, 1).numpy()
    np.savez(out, distance=distance, pixel=pixel)
    print(json.dumps(row))


def rows(checkpoint: str, folder: Path) -> list[dict]:
    best: dict[str, dict] = {}
    for _ in range(ROUNDS):
        for precision in PRECISIONS:
            out = folder / f"{precision}.npz"
            words = [sys.executable, "-m", __spec__.name, checkpoint, "--one", precision, str(out)]
            # OpenMP's waiting threads are busy by default, and CPU time would be no work.
            env = os.environ | {"OMP_WAIT_POLICY": "PASSIVE"}
            done = subprocess.run(words, env=env, stdout=subprocess.PIPE, check=True)
            row = json.loads(done.stdout)
            before = best.setdefault(precision, row)
            best[precision] = row | {key: min(row[key], before[key]) for key in TIMES}
            print(f"{precision}: {row['seconds']:.1f} s", file=sys.stderr)
            best[precision] |= errors(out, folder / "float32.npz")
    first = best["float32"]
    return [row | {"share": row["cpu"] / first["cpu"]} for row in best.values()]


def errors(predicted: Path, exact: Path) -> dict[str, float]:
    predicted, exact = dict(np.load(predicted)), dict(np.load(exact))
    off = {
        "distance": np.abs(predicted["distance"] / exact["distance"] - 1),
        "pixel": np.abs(predicted["pixel"] - exact["pixel"]),
    }
    return {f"{name}_mean": values.mean() for name, values in off.items()} | {
        f"{name}_greatest": values.max() for name, values in off.items()
    }


COLUMNS = {
    "precision": ("precision", str),
    "load": ("load, s", ".2f"),
    "seconds": ("s", ".2f"),
    "cpu": ("CPU, s", ".2f"),
    "share": ("of first", ".2f"),
    "peak": ("peak, MB", ",.0f"),
    "distance_mean": ("distance: mean", error),
    "distance_greatest": ("greatest", error),
    "pixel_mean": ("pixel: mean", error),
    "pixel_greatest": ("greatest", error),
}


def main() -> None:
    arguments = parser(__doc__, "mvsplat.md")
    arguments.add_argument("checkpoint", nargs="?", metavar="CHECKPOINT", help="such as re10k.ckpt")
    arguments.add_argument("--one", nargs=2, help="used by itself")
    args = arguments.parse_args()
    if args.one:
        measure(args.checkpoint, *args.one)
        return
    with tempfile.TemporaryDirectory() as folder:
        checkpoint = args.checkpoint
        if checkpoint is None:
            checkpoint = str(Path(folder) / "recipe.ckpt")
            torch.save(recipe_weights(), checkpoint)
        tables = table(rows(checkpoint, Path(folder)), COLUMNS)
    command = "python -m benches.predict.mvsplat_cost" + " CHECKPOINT" * bool(args.checkpoint)
    publish(args.out, "mvsplat.md", command, tables)


if __name__ == "__main__":
    threads.limit()
    main()
