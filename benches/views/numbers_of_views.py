"""Gain of 3 to 8 context views over 2, at the same held-out targets.

    python -m benches.views.numbers_of_views DATA [-o docs/measured] [--every 10] [--rooms 20]

DATA holds ``office_walk``, ``fern`` and ``places``.

- walk: every second frame of a window is a context view. The target is always the frame between
  the first two, so further views lead away from it.
- fern: the targets are three photographs, at a quarter, half and three quarters along the widest
  direction. Context views are evenly spaced among the others, without two at each end.
- places: each pair of ``pairs.json`` whose place has further photographs, with views chosen by
  ``slgaussian/datasets/context_views.py``, as many as available.
- rooms: procedural rooms with exact depth. Cameras are on an arc 1.6 m long, 3.3 m from the centre;
  three targets are in gaps between the context views of all numbers.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian import datasets
from slgaussian.benchmark.index import read_index
from slgaussian.benchmark.metrics import depth_errors, psnr, ssim
from slgaussian.datasets.context_views import choose_context
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import threads
from slgaussian.labels import MIN_WEIGHT
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import rasterize
from slgaussian.scene import Sample, Scene

Row = dict[str, Any]

NUMBERS = (2, 3, 4, 6, 8)
OF_WALK = (2, 3, 4, 6)

ARC = 210
"""Number of steps of the arc: divisible by 1, 2, 3, 5 and 7, for 2, 3, 4, 6 and 8 even views."""
TARGETS = (51, 112, 159)
"""Steps of the targets, at least 7 from the context views of each of :data:`NUMBERS`."""
BASELINE, SIZE = 1.6, {"height": 208, "width": 288}


def measure_views(
    scene: Scene, contexts: Mapping[int, Sequence[str]], targets: Sequence[str], name: str
) -> Iterator[Row]:
    """Yield a row for each number of context views, all at the same targets."""
    scene = replace(scene, read=cache(scene.read))
    for number, context in contexts.items():
        row: Row = {"of": name, "views": number}
        try:
            yield row | figures(scene.sample(context, targets, "auto"))
        except SLGaussianError as error:
            yield row | {"refused": str(error)}


def figures(sample: Sample) -> Row:
    """Predict Gaussians; return their scores at the targets, and their cost."""
    start = time.process_time()
    gaussians = PlaneSweep()(sample)
    cost = {"gaussians": len(gaussians), "seconds": time.process_time() - start}
    return at_targets(sample, gaussians) | cost


def at_targets(sample: Sample, gaussians: Gaussians) -> Row:
    """Return mean PSNR, SSIM and, with true depth, depth error over the targets."""
    scores: dict[str, list[float]] = {}
    for target in sample.targets:
        render = rasterize(gaussians, gaussians.colours(), target.camera, median=True)
        drawn = np.rint(render.values.numpy().clip(0, 1) * 255).astype(np.uint8)
        scores.setdefault("psnr", []).append(psnr(drawn, target.image))
        scores.setdefault("ssim", []).append(ssim(drawn, target.image))
        if target.depth is not None and (target.depth > 0).any():
            visible = render.alpha.numpy() >= MIN_WEIGHT
            depth = np.where(visible, render.median.numpy(), 0)
            scores.setdefault("depth", []).append(depth_errors(depth, target.depth)["abs_rel"])
    return {name: float(np.mean(values)) for name, values in scores.items()}


def walk(folder: Path, every: int) -> Iterator[Row]:
    """Yield the rows of all windows of a walk."""
    scene = datasets.load("nerfstudio", folder)
    frames, length = sorted(scene.cameras), 2 * max(OF_WALK) - 1
    for start in range(0, len(frames) - length + 1, every):
        names = frames[start : start + length]
        contexts = {number: names[: 2 * number - 1 : 2] for number in OF_WALK}
        yield from measure_views(scene, contexts, names[1:2], f"frame {start}")


def fern(folder: Path) -> Iterator[Row]:
    """Yield the rows of a forward-facing capture."""
    scene = datasets.load("llff", folder)
    centers = np.array([camera.center for camera in scene.cameras.values()])
    offsets = centers - centers.mean(0)
    along = np.argsort(offsets @ np.linalg.svd(offsets)[2][0])
    names = [list(scene.cameras)[i] for i in along]
    targets = [names[len(names) * k // 4] for k in (1, 2, 3)]
    rest = [name for name in names[2:-2] if name not in targets]
    yield from measure_views(scene, {n: evenly(rest, n) for n in NUMBERS}, targets, folder.name)


def place(folder: Path) -> Iterator[Row]:
    """Yield the rows of each pair of a place, for the numbers of views that it has."""
    scene = datasets.load("nerfstudio", folder)
    for name, pair in read_index(folder / "pairs.json").scenes.items():
        contexts = {}
        for number in NUMBERS:
            try:
                contexts[number] = choose_context(scene, pair.context, pair.target, number)
            except InputError:  # too few photographs
                break
        if len(contexts) > 1:
            yield from measure_views(scene, contexts, pair.target, name)


def room(seed: int) -> Iterator[Row]:
    """Yield the rows of a procedural room."""
    scene = datasets.load("procedural", seed, views=ARC + 1, baseline=BASELINE, **SIZE)
    names = list(scene.cameras)
    contexts = {number: evenly(names, number) for number in NUMBERS}
    yield from measure_views(scene, contexts, [names[k] for k in TARGETS], f"room {seed}")


def evenly(names: Sequence[str], count: int) -> list[str]:
    return [names[round(i * (len(names) - 1) / (count - 1))] for i in range(count)]


def summary(rows: Sequence[Row]) -> list[Row]:
    """Return a row per number: means over scenes that also have two views, and paired gains."""
    two = {row["of"]: row for row in rows if row["views"] == 2 and "refused" not in row}
    lines = []
    for number in NUMBERS:
        selected = [row for row in rows if row["views"] == number and row["of"] in two]
        done = [row for row in selected if "refused" not in row]
        if not done:
            continue
        line: Row = {"views": number, "scenes": len(done), "refused": len(selected) - len(done)}
        for name in ("psnr", "ssim", "depth", "gaussians", "seconds"):
            values = [row[name] for row in done if name in row]
            if values:
                line[name] = float(np.mean(values))
        if number > 2:
            gains = np.array([row["psnr"] - two[row["of"]]["psnr"] for row in done])
            line |= {"gain": gains.mean(), "worst": gains.min()}
            line |= {"spread": gains.std(ddof=1)} if len(done) > 1 else {}
        lines.append(line)
    return lines


COLUMNS = {
    "views": ("views", "d"),
    "scenes": ("scenes", "d"),
    "psnr": ("PSNR", ".2f"),
    "gain": ("over two", "+.2f"),
    "spread": ("spread", ".2f"),
    "worst": ("worst", "+.2f"),
    "ssim": ("SSIM", ".3f"),
    "depth": ("depth error", ".3f"),
    "gaussians": ("Gaussians", ",.0f"),
    "seconds": ("CPU, s", ".1f"),
    "refused": ("refused", "d"),
}


def main() -> None:
    arguments = parser(__doc__, "views.md")
    arguments.add_argument("data", type=data_folder("office_walk", "fern", "places"))
    arguments.add_argument("--every", type=int, default=10, help="frames between two windows")
    arguments.add_argument("--rooms", type=int, default=20)
    args = arguments.parse_args()
    threads.limit()
    figures(datasets.load("procedural", **SIZE).sample(["view_00", "view_03"], ["view_01"]))
    folders = sorted((args.data / "places").glob("*/pairs.json"))
    sets = {
        "walk": walk(args.data / "office_walk", args.every),
        "fern": fern(args.data / "fern"),
        "places": (row for file in folders for row in place(file.parent)),
        "rooms": (row for seed in range(args.rooms) for row in room(seed)),
    }
    parts: list[str] = []
    for name, rows in sets.items():
        lines = summary(list(rows))
        columns = {k: v for k, v in COLUMNS.items() if any(k in line for line in lines)}
        parts += [f"{name.capitalize()}:", table(lines, columns)]
        print(parts[-1], flush=True)
    publish(args.out, "views.md", "python -m benches.views.numbers_of_views DATA", *parts)


if __name__ == "__main__":
    main()
