"""Speed and error of the rasteriser, compared with the loop of ``plain_loop.py``.

    python -m benches.rasterize.speed_and_error [DATA] [-o docs/measured] [--scene NAME]

DATA holds pairs of photographs; without it, the scene is a procedural room. Cut-offs and numbers of
Gaussians and channels are measured on one scene, by default the first of DATA.

Errors of the whole image are relative to the cpu backend with the finest cut-offs (:data:`FINE`).
The error of that backend relative to the float64 reference, which is too slow for whole images, is
measured on windows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from benches.common.harness import error, ms, parser, publish, table, times_in_turn
from benches.common.photograph_pairs import DATA_HELP, load_samples, photographs
from benches.rasterize.plain_loop import splat_in_order
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import threads
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import PRESETS, Settings, rasterize
from slgaussian.scene import Camera, Sample

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
"""Left and top corners of the windows, as fractions of the image size."""


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
        values = torch.cat([gaussians.colours(), random_values(len(gaussians), 3)], 1)
        return Subject(name, gaussians, values, sample.targets[0].camera)

    def part(self, share: int) -> Subject:
        """Return a random subset with one of every ``share`` Gaussians."""
        generator = torch.Generator().manual_seed(0)
        rows = torch.randperm(len(self.gaussians), generator=generator)
        rows = rows[: len(rows) // share].sort().values
        return replace(self, gaussians=self.gaussians[rows], values=self.values[rows])

    def by_loop(self) -> torch.Tensor:
        arrays = self.gaussians.to_arrays()
        return torch.from_numpy(splat_in_order(arrays, self.values.numpy(), self.camera))

    def draw(self, settings: Settings = DEFAULT, backend: str = "cpu") -> torch.Tensor:
        inputs = self.gaussians, self.values, self.camera
        return rasterize(*inputs, backend=backend, settings=settings).values


def random_values(n: int, channels: int) -> torch.Tensor:
    """Return values float32 in [0, 1], independent between neighbours, like random ID codes."""
    return torch.rand(n, channels, generator=torch.Generator().manual_seed(0))


def both_ways(subject: Subject) -> Callable[[], object]:
    """Return a call of the forward and backward pass for geometry, opacities and values."""
    gaussians, values = subject.gaussians, subject.values.clone().requires_grad_()
    leaves = {
        name: getattr(gaussians, name).clone().requires_grad_()
        for name in ("means", "scales", "quats", "opacities")
    }
    free, wanted = replace(gaussians, **leaves), [*leaves.values(), values]
    size = subject.camera.height, subject.camera.width, values.shape[1]
    upstream = torch.rand(*size, device=values.device)
    return lambda: torch.autograd.grad(
        rasterize(free, values, subject.camera).values, wanted, upstream
    )


def duel(subject: Subject, **contenders: Callable[[], object]) -> dict[str, float]:
    """Return seconds of the plain loop, the default settings and others, and the largest error."""
    spent = times_in_turn({"loop": subject.by_loop, "fast": subject.draw, **contenders})
    off = subject.draw() - subject.draw(replace(DEFAULT, **FINE))
    return spent | {"ratio": spent["loop"] / spent["fast"], "greatest": float(off.abs().max())}


def scene_row(subject: Subject) -> dict:
    """Return the seconds of a scene, and errors of the default settings, also against float64."""
    worst = {"window": 0.0, "floor": 0.0}
    camera = subject.camera
    for x, y in WINDOWS:
        corner = round(x * camera.width), round(y * camera.height)
        window = replace(subject, camera=camera.crop(*corner, WINDOW, WINDOW))
        true = window.draw(backend="reference")
        for name, settings in (("window", DEFAULT), ("floor", replace(DEFAULT, **FINE))):
            off = float((window.draw(settings) - true).abs().max())
            worst[name] = max(worst[name], off)
    times = duel(subject, both=both_ways(subject))
    return {"scene": subject.name, "gaussians": len(subject.gaussians), **times, **worst}


def cut_rows(subject: Subject) -> list[dict]:
    """Return the times and errors of the plain loop and of each of the cut-offs :data:`CUTS`."""
    contenders = {LOOP: subject.by_loop} | {
        name: lambda settings=settings: subject.draw(settings) for name, settings in CUTS.items()
    }
    spent = times_in_turn(contenders)
    rows = []
    for name, draw in contenders.items():
        off = (draw() - subject.draw(replace(CUTS.get(name, DEFAULT), **FINE))).abs()
        row = {"what": name, "fast": spent[name], "ratio": spent[LOOP] / spent[name]}
        rows.append(row | {"greatest": float(off.max()), "mean": float(off.mean())})
    return rows


def size_rows(subject: Subject) -> list[dict]:
    """Return rows for parts of the scene, and for the whole with other numbers of channels."""
    rows = []
    for share in COUNT_PARTS:
        part = subject.part(share)
        rows.append({"gaussians": len(part.gaussians), "channels": 6} | duel(part))
    n = len(subject.gaussians)
    for channels in CHANNELS:
        values = replace(subject, values=random_values(n, channels))
        rows.append({"gaussians": n, "channels": channels} | duel(values))
    return rows


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
    args = arguments.parse_args()
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
    publish(
        args.out,
        "rasterizer.md",
        "python -m benches.rasterize.speed_and_error DATA",
        table(scenes, of_scene | TIMES),
        table(cut_rows(swept), of_cuts),
        table(size_rows(swept), of_sizes),
    )


if __name__ == "__main__":
    threads.limit()
    main()
