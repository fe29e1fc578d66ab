"""Speed, error and memory of the rasteriser, compared with the loop of ``plain_loop.py``.

    python -m benches.rasterize.speed_and_error [DATA] [-o docs/measured] [--scene NAME]

DATA holds pairs of photographs; without it, a made-up room is drawn. Cut-offs, numbers of Gaussians
and channels, and memory are of one scene, the first of DATA by default.

Errors are those of the whole image, against the cpu backend with nearly nothing cut (:data:`FINE`).
How far that is from the float64 reference, which is too slow for an image of half a million
Gaussians, is measured on windows.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from benches.common.harness import error, ms, parser, publish, table, times_in_turn
from benches.common.photograph_pairs import DATA_HELP, load_samples, photographs
from benches.rasterize.plain_loop import splat_in_order
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import threads
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import PRESETS, Settings, plan, rasterize
from slgaussian.scene import Camera, Sample
from slgaussian.system import memory_status, reset_peak_memory

DEFAULT = Settings()
FINE = {"alpha_min": 2.0**-20, "sigmas": math.inf, "pass_min": 0.0}

LOOP = "plain loop"
CUTS = {
    "3dgs (alpha 1/255, 3 sigmas)": PRESETS["3dgs"],
    "alpha 1/255": Settings(alpha_min=1 / 255, pass_min=1 / 255),
    "alpha 1/1024": Settings(alpha_min=1 / 1024, pass_min=1 / 1024),
    "fast (alpha 1/4096)": DEFAULT,
    "alpha 1/65536": Settings(alpha_min=2.0**-16, pass_min=2.0**-16),
}

COUNT_PARTS = (64, 16, 4, 1)
CHANNELS = (1, 3, 6, 16, 64, 512)

WINDOW = 8
WINDOWS = ((0.3, 0.4), (0.5, 0.5), (0.7, 0.3), (0.6, 0.8))
"""Left and top corners of the windows, as shares of the image."""


@dataclass(frozen=True, eq=False)
class Subject:
    """Rendered input: ``values`` float32 [N, C] of ``gaussians``, from ``camera``."""

    name: str
    gaussians: Gaussians
    values: torch.Tensor
    camera: Camera

    @staticmethod
    def of(name: str, sample: Sample) -> Subject:
        """Predict Gaussians from two photographs; their values are colours and random codes."""
        gaussians = PlaneSweep()(sample)
        values = torch.cat([gaussians.colors(), random_values(len(gaussians), 3)], 1)
        return Subject(name, gaussians, values, sample.targets[0].camera)

    def part(self, share: int) -> Subject:
        """One Gaussian of every ``share``, drawn at random; the others are left out."""
        generator = torch.Generator().manual_seed(0)
        rows = torch.randperm(len(self.gaussians), generator=generator)
        rows = rows[: len(rows) // share].sort().values
        return replace(self, gaussians=self.gaussians[rows], values=self.values[rows])

    def by_loop(self) -> torch.Tensor:
        arrays = self.gaussians.to_arrays()
        return torch.from_numpy(splat_in_order(arrays, self.values.numpy(), self.camera))

    def drawn(self, settings: Settings = DEFAULT, backend: str = "cpu") -> torch.Tensor:
        given = self.gaussians, self.values, self.camera
        return rasterize(*given, backend=backend, settings=settings).values


def random_values(n: int, channels: int) -> torch.Tensor:
    """As different from neighbour to neighbour as ID codes can be, float32 in [0, 1]."""
    return torch.rand(n, channels, generator=torch.Generator().manual_seed(0))


def both_ways(subject: Subject) -> Callable[[], object]:
    """Forward and backward for means, scales, quaternions, opacities and values."""
    gaussians, values = subject.gaussians, subject.values.clone().requires_grad_()
    leaves = {
        name: getattr(gaussians, name).clone().requires_grad_()
        for name in ("means", "scales", "quats", "opacities")
    }
    free, wanted = replace(gaussians, **leaves), [*leaves.values(), values]
    upstream = torch.rand(subject.camera.height, subject.camera.width, values.shape[1])
    return lambda: torch.autograd.grad(
        rasterize(free, values, subject.camera).values, wanted, upstream
    )


def duel(subject: Subject, **others: Callable[[], object]) -> dict[str, float]:
    """Seconds of the plain loop, of the default settings and of others, and the greatest error."""
    spent = times_in_turn({"loop": subject.by_loop, "fast": subject.drawn, **others})
    off = subject.drawn() - subject.drawn(replace(DEFAULT, **FINE))
    return spent | {"ratio": spent["loop"] / spent["fast"], "greatest": float(off.abs().max())}


def scene_row(subject: Subject) -> dict:
    """Seconds of a scene, and errors of the default settings, in windows against float64 too."""
    worst = {"window": 0.0, "floor": 0.0}
    camera = subject.camera
    for x, y in WINDOWS:
        corner = round(x * camera.width), round(y * camera.height)
        window = replace(subject, camera=camera.cropped(*corner, WINDOW, WINDOW))
        true = window.drawn(backend="reference")
        for name, settings in (("window", DEFAULT), ("floor", replace(DEFAULT, **FINE))):
            off = float((window.drawn(settings) - true).abs().max())
            worst[name] = max(worst[name], off)
    times = duel(subject, both=both_ways(subject))
    return {"scene": subject.name, "gaussians": len(subject.gaussians), **times, **worst}


def cut_rows(subject: Subject) -> list[dict]:
    """Compare the plain loop and the cut-offs of :data:`CUTS` with the same without cut-offs."""
    contenders = {LOOP: subject.by_loop} | {
        name: lambda settings=settings: subject.drawn(settings) for name, settings in CUTS.items()
    }
    spent = times_in_turn(contenders)
    rows = []
    for name, draw in contenders.items():
        off = (draw() - subject.drawn(replace(CUTS.get(name, DEFAULT), **FINE))).abs()
        row = {"what": name, "fast": spent[name], "ratio": spent[LOOP] / spent[name]}
        rows.append(row | {"greatest": float(off.max()), "mean": float(off.mean())})
    return rows


def size_rows(subject: Subject) -> list[dict]:
    """Parts of the scene with six channels, and the whole with random values of other numbers."""
    rows = []
    for share in COUNT_PARTS:
        part = subject.part(share)
        rows.append({"gaussians": len(part.gaussians), "channels": 6} | duel(part))
    n = len(subject.gaussians)
    for channels in CHANNELS:
        values = replace(subject, values=random_values(n, channels))
        rows.append({"gaussians": n, "channels": channels} | duel(values))
    return rows


JOBS: dict[str, Callable[[Subject], object]] = {
    "one picture": Subject.drawn,
    "forward and backward": lambda subject: both_ways(subject)(),
    "plan of one view": lambda subject: plan(subject.gaussians, subject.camera),
}


def memory_rows(subject: Subject) -> list[dict]:
    """Megabytes beyond libraries, kernels and inputs, each job in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.npz"
        seen = subject.camera
        camera = {"K": seen.K, "c2w": seen.c2w, "size": [seen.width, seen.height]}
        values = subject.values.numpy()
        np.savez(file, **subject.gaussians.to_arrays(), **camera, values=values)
        command = [sys.executable, "-m", "benches.rasterize.speed_and_error", "--memory", file]
        return [
            {"what": job} | json.loads(subprocess.check_output([*command, job])) for job in JOBS
        ]


def memory(file: str, job: str) -> dict[str, float]:
    """Do a job once, after the same for a few Gaussians: megabytes at most and at the end."""
    arrays = dict(np.load(file))
    camera = Camera(arrays.pop("K"), arrays.pop("c2w"), *arrays.pop("size").tolist())
    values = torch.from_numpy(arrays.pop("values"))
    subject = Subject(job, Gaussians.from_arrays(arrays), values, camera)
    JOBS[job](replace(subject.part(5000), camera=camera.resized(32, 32)))
    before = memory_status("VmRSS")
    reset_peak_memory()
    result = JOBS[job](subject)
    found = {
        "peak": (memory_status("VmHWM") - before) / 1e6,
        "kept": (memory_status("VmRSS") - before) / 1e6,
    }
    del result
    return found


TIMES = {
    "loop": ("plain loop, ms", ms),
    "fast": ("rasterize, ms", ms),
    "ratio": ("times faster", ".2f"),
    "both": ("back and forth, ms", ms),
    "greatest": ("greatest error", error),
    "window": ("in windows, against float64", error),
    "floor": ("of nothing cut, against float64", error),
}


def main() -> None:
    arguments = parser(__doc__, "rasterizer.md")
    arguments.add_argument("data", nargs="?", type=photographs, metavar="DATA", help=DATA_HELP)
    arguments.add_argument("--scene", help="of all tables but the first")
    arguments.add_argument("--memory", nargs=2, metavar=("FILE", "JOB"), help="used by itself")
    args = arguments.parse_args()
    if args.memory:
        print(json.dumps(memory(*args.memory)))
        return
    subjects = (Subject.of(*item) for item in load_samples(args.data).items())
    scenes, swept = [], None
    for subject in subjects:
        scenes.append(scene_row(subject))
        if swept is None or subject.name == args.scene:
            swept = subject
    assert swept is not None
    of_scene = {"scene": ("scene", str), "gaussians": ("Gaussians", ",d")}
    of_cuts = {"what": ("settings", str), "fast": ("ms", ms)}
    of_cuts |= {name: TIMES[name] for name in ("ratio", "greatest")} | {"mean": ("mean", error)}
    of_sizes = {"gaussians": ("Gaussians", ",d"), "channels": ("channels", "d")}
    of_sizes |= {name: TIMES[name] for name in ("loop", "fast", "ratio", "greatest")}
    of_memory = {"what": ("what", str), "peak": ("peak, MB", ".0f"), "kept": ("kept, MB", ".0f")}
    publish(
        args.out,
        "rasterizer.md",
        "python -m benches.rasterize.speed_and_error DATA",
        table(scenes, of_scene | TIMES),
        table(cut_rows(swept), of_cuts),
        table(size_rows(swept), of_sizes),
        table(memory_rows(swept), of_memory),
    )


if __name__ == "__main__":
    threads.limit()
    main()
