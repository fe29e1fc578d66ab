"""What a field keeps of its Gaussians, what that costs in pictures and seconds, and other rules.

    python -m benches.rasterize.kept_gaussians DATA [--rooms 10] [-o docs/measured]

DATA holds ``office`` and ``places`` (pairs of photographs with a target between them),
``office_walk`` (windows of three frames, the middle one the target; and of six and of twelve
context views) and ``fern`` (an LLFF capture, windows of three). -o writes kept.md.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from benches.common.pages import publish
from benches.common.paired_timing import paired_times
from benches.common.photograph_pairs import data_folder
from slgaussian import datasets
from slgaussian.benchmark.index import read_index
from slgaussian.benchmark.metrics import psnr
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.errors import SLGaussianError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import threads
from slgaussian.kernels.simd import LANES
from slgaussian.rasterize import plan
from slgaussian.rasterize.merging import merge
from slgaussian.scene import Camera, Sample

EVERY = 20
"""Frames of the walk from one window to the next."""

MANY = {6: (20, 60, 100), 12: (20, 60)}
"""First frames of windows of the walk of more context views, which are every second frame."""

LEAST_LIGHTS = (0.05, 0.1)
"""Weights below which the other rule drops what has no more in any pixel of the context views."""

HIDDEN = 1e-4
"""What has no more light than this is seen by no context view, and stays."""

Rule = Callable[[Gaussians, Sequence[Camera]], Gaussians]


def merged(gaussians: Gaussians, cameras: Sequence[Camera]) -> Gaussians:
    return merge(gaussians, cameras).gaussians


def lit(least: float) -> Rule:
    """Drop what has less light in every pixel of the given views, but not what has none."""

    def drop(gaussians: Gaussians, cameras: Sequence[Camera]) -> Gaussians:
        most = np.zeros(len(gaussians), np.float32)
        for camera in cameras:
            planned = plan(gaussians, camera)
            begins, blocks = planned.by_gaussian
            weights = planned.weights_by_gaussian.view(np.float16).reshape(len(blocks), LANES)
            owners = np.repeat(np.arange(len(most)), np.diff(begins))
            np.maximum.at(most, owners, weights.max(1).astype(np.float32))
        return gaussians[torch.from_numpy((most >= least) | (most < HIDDEN))]

    return drop


RULES = {
    "merge even neighbours (the default)": merged,
    **{f"drop what has less light than {least}": lit(least) for least in LEAST_LIGHTS},
}


def samples(data: Path, rooms: int) -> Iterator[tuple[str, str, Sample]]:
    """Set, name and sample: two context views, and one target that they do not include."""
    for folder in (data / "office", *sorted((data / "places").iterdir())):
        if not (folder / "pairs.json").is_file():
            continue
        scene = datasets.load("nerfstudio", folder)
        for pair in read_index(folder / "pairs.json").pairs:
            of = "office" if folder.name == "office" else "places"
            yield of, pair.scene, scene.sample(list(pair.context), list(pair.targets[:1]), "auto")
    for name, format in (("office_walk", "nerfstudio"), ("fern", "llff")):
        scene = datasets.load(format, data / name)
        names = sorted(scene.cameras)
        for start in range(0, len(names) - 2, EVERY if name == "office_walk" else 3):
            first, target, second = names[start : start + 3]
            yield name, f"{name} {start}", scene.sample([first, second], [target], "auto")
    scene = datasets.load("nerfstudio", data / "office_walk")
    names = sorted(scene.cameras)
    for count, starts in MANY.items():
        for start in starts:
            context = names[start : start + 2 * count : 2]
            sample = scene.sample(context, [names[start + count + 1]], "auto")
            yield f"office_walk, {count} views", f"{count} views {start}", sample
    for seed in range(rooms):
        scene = datasets.load("procedural", seed=seed, views=3, height=360, width=540)
        names = list(scene.cameras)
        yield "rooms", f"room {seed}", scene.sample([names[0], names[2]], names[1:2])


def rows_of(of: str, name: str, sample: Sample) -> Iterator[dict]:
    """A row a rule: what is left of the Gaussians of the field of a sample."""
    field = build_field(sample, Method(keep="all"))
    cameras = [view.camera for view in sample.context]
    before = [field.render(camera) for camera in cameras]
    target = sample.targets[0]
    seen = field.render(target.camera)
    for rule, apply in RULES.items():
        apply(field.gaussians[:1000], cameras)  # compiles
        start = time.process_time()
        left = field.changed(gaussians=apply(field.gaussians, cameras))
        seconds = time.process_time() - start
        changes = [
            _difference(left, camera, was.rgb) for camera, was in zip(cameras, before, strict=True)
        ]
        view = left.render(target.camera)
        times = paired_times(
            {
                "before": lambda: field.render(target.camera),
                "after": lambda left=left: left.render(target.camera),
            },
            clock=time.process_time,
        )
        yield {
            "set": of,
            "name": name,
            "rule": rule,
            "made": len(field.gaussians),
            "kept": len(left.gaussians),
            "share": len(left.gaussians) / len(field.gaussians),
            "mean": float(np.mean([change.mean() for change in changes])),
            "rms": max(float(np.sqrt(np.square(change).mean())) for change in changes),
            "greatest": max(float(change.max()) for change in changes),
            "seconds": seconds,
            "faster": times["before"] / times["after"],
            "novel": float(np.abs(view.rgb.astype(float) - seen.rgb).mean()),
            "gain": psnr(view.rgb, target.image) - psnr(seen.rgb, target.image),
            "ids": float((view.ids != seen.ids).mean()),
        }


def _difference(field: SemanticField, camera: Camera, was: np.ndarray) -> np.ndarray:
    return np.abs(field.render(camera).rgb.astype(float) - was)


def summary(rows: Sequence[dict]) -> list[dict]:
    """A row a set and rule: means over its scenes, and the worst of what is to stay."""
    found = []
    for of, rule in dict.fromkeys((row["set"], row["rule"]) for row in rows):
        own = [row for row in rows if (row["set"], row["rule"]) == (of, rule)]
        line = {"set": of, "rule": rule, "scenes": len(own)}
        for key in ("made", "share", "mean", "rms", "novel", "gain", "ids", "seconds", "faster"):
            line[key] = float(np.mean([row[key] for row in own]))
        line["spread"] = float(np.std([row["share"] for row in own]))
        line["worst_rms"] = max(row["rms"] for row in own)
        line["greatest"] = max(row["greatest"] for row in own)
        line["worst"] = min(row["gain"] for row in own)
        found.append(line)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=data_folder("office", "places", "office_walk", "fern"))
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("-o", dest="out", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    threads.limit()
    rows: list[dict] = []
    refused: list[str] = []
    for of, name, sample in samples(given.data, given.rooms):
        try:
            rows += rows_of(of, name, sample)
        except SLGaussianError as error:
            refused.append(str(error))
        print(f"{name} done", flush=True)
    file = given.out and given.out / "kept.md"
    publish("rasterize/kept.md.j2", file, rows=summary(rows), refused=refused, every=EVERY)


if __name__ == "__main__":
    main()
