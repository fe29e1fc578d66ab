"""What pruning leaves, what that changes and how fast the rest draws.

    python -m benches.rasterize.pruning_error [DATA]

DATA is a nerfstudio folder with pairs.json; without it, a made-up room is drawn.
"""

import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benches.common.pages import page
from benches.common.paired_timing import paired_times
from benches.common.photograph_pairs import load_samples, photographs
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import threads
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import prune, rasterize
from slgaussian.scene import Camera

GREY = 1 / 255
TOLERANCES = (GREY / 2, GREY, 2 * GREY, 4 * GREY)


def sweep(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    tolerances: Sequence[float],
    held_out: Camera | None = None,
) -> list[dict]:
    """A row a tolerance: what is left when ``cameras`` are given, and how it does elsewhere."""
    prune(gaussians[:0], cameras, 0)  # compiles
    return [_row(gaussians, cameras, tolerance, held_out) for tolerance in tolerances]


def scene_rows(
    name: str, gaussians: Gaussians, contexts: Sequence[Camera], target: Camera
) -> list[dict]:
    """The rows of one scene at one grey level: given all three views, and the contexts."""
    given = {
        "contexts and target": ([*contexts, target], None),
        "contexts": (contexts, target),
    }
    return [
        {"scene": name, "views": views, **row}
        for views, (cameras, held_out) in given.items()
        for row in sweep(gaussians, cameras, [GREY], held_out)
    ]


def _row(
    gaussians: Gaussians, cameras: Sequence[Camera], tolerance: float, held_out: Camera | None
) -> dict:
    start = time.perf_counter()
    pruned = prune(gaussians, cameras, tolerance)
    seconds = time.perf_counter() - start
    row = {
        "tolerance": tolerance,
        "gaussians": len(gaussians),
        "kept": len(pruned.kept),
        "share": len(pruned.kept) / len(gaussians),
        "error": pruned.error,
        "seconds": seconds,
    }
    row |= paired_times(
        {
            "before": lambda: rasterize(gaussians, None, cameras[0]),
            "after": lambda: rasterize(pruned.gaussians, None, cameras[0]),
        }
    )
    if held_out is not None:
        before = rasterize(gaussians, None, held_out).values
        change = rasterize(pruned.gaussians, None, held_out).values - before
        square = float(change.double().square().mean())
        row["held_out_error"] = float(change.abs().max())
        row["held_out_psnr"] = -10 * math.log10(square) if square else math.inf
    return row


def run(data: Path | None) -> None:
    rows = {"scenes": [], "tolerances": []}
    for name, sample in load_samples(data).items():
        gaussians = PlaneSweep()(sample)
        contexts = [view.camera for view in sample.context]
        target = sample.targets[0].camera
        rows["scenes"] += scene_rows(name, gaussians, contexts, target)
        if not rows["tolerances"]:
            rows["tolerances"] = sweep(gaussians, contexts, TOLERANCES, target)
    print(page("rasterize/pruning.md.j2", rows=rows))


if __name__ == "__main__":
    threads.limit()
    try:
        run(photographs(sys.argv[1]) if len(sys.argv) > 1 else None)
    except (InputError, OSError) as problem:
        sys.exit(f"error: {problem}")
