"""What the Gaussians of some context views are worth at held-out targets, and what they cost.

A row of figures is a scene with one number of context views: PSNR (dB) and SSIM of the drawn
targets, mean relative error of their drawn depth where it is known, Gaussians, seconds of the
processor and megabytes; and the same pictures from the best two of the same views, the pair whose
PSNR is highest. A number that is refused has its reason instead.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from benches.common.markdown_tables import table
from slgaussian import datasets
from slgaussian.benchmark.metrics import depth_errors, psnr, ssim
from slgaussian.benchmark.resident_memory import forget_peak, give_back, held
from slgaussian.errors import SLGaussianError
from slgaussian.gaussians import Gaussians
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import rasterize
from slgaussian.scene import Sample, Scene
from slgaussian.semantic.decode import VISIBLE

Row = dict[str, Any]

SIZE = "auto"


def by_numbers(
    scene: Scene,
    contexts: Mapping[int, Sequence[str]],
    targets: Sequence[str],
    of: str,
) -> Iterator[Row]:
    """A row for each number of context views, all at the same targets; ``of`` says of what."""
    scene = replace(scene, read=cache(scene.read))
    pairs: dict[tuple[str, ...], Row] = {}
    for number, context in contexts.items():
        named = {"of": of, "views": number}
        try:
            row = measured(scene.sample(context, targets, SIZE))
        except SLGaussianError as error:
            yield named | {"refused": str(error)}
            continue
        for pair in combinations(context, 2):
            if pair not in pairs:
                pairs[pair] = row if pair == tuple(context) else _of_pair(scene, pair, targets)
        best = max((pairs[pair] for pair in combinations(context, 2)), key=_psnr)
        two = {f"best_two_{name}": best[name] for name in ("psnr", "ssim", "depth") if name in best}
        yield named | row | two


def warm_up() -> None:
    """Have the kernels compiled, so that no figure holds the time that takes."""
    scene = datasets.load("procedural", height=64, width=96)
    measured(scene.sample(["view_00", "view_03"], ["view_01"]))


def measured(sample: Sample) -> Row:
    """The figures of the Gaussians that the plane sweep makes of a sample."""
    give_back()
    forget_peak()
    start = time.process_time()
    gaussians = PlaneSweep()(sample)
    seconds = time.process_time() - start
    memory = held("VmHWM") / 2**20
    cost = {"gaussians": len(gaussians), "seconds": seconds, "memory": memory}
    return at_targets(sample, gaussians) | cost


def at_targets(sample: Sample, gaussians: Gaussians) -> Row:
    """PSNR, SSIM and, where it is known, depth error, means over the targets."""
    found: dict[str, list[float]] = {}
    for target in sample.targets:
        render = rasterize(gaussians, gaussians.colors(), target.camera, median=True)
        drawn = np.rint(render.values.numpy().clip(0, 1) * 255).astype(np.uint8)
        found.setdefault("psnr", []).append(psnr(drawn, target.image))
        found.setdefault("ssim", []).append(ssim(drawn, target.image))
        if target.depth is not None and (target.depth > 0).any():
            seen = render.alpha.numpy() >= VISIBLE
            depth = np.where(seen, render.median.numpy(), 0)
            found.setdefault("depth", []).append(depth_errors(depth, target.depth)["abs_rel"])
    return {name: float(np.mean(values)) for name, values in found.items()}


def summary(rows: Sequence[Row], numbers: Sequence[int]) -> list[Row]:
    """A row a number: means over the scenes that it and two views can do, and gains in pairs."""
    two = {row["of"]: row for row in rows if row["views"] == 2 and "refused" not in row}
    found = []
    for number in numbers:
        all_own = [row for row in rows if row["views"] == number and row["of"] in two]
        own = [row for row in all_own if "refused" not in row]
        if not own:
            continue
        line: Row = {"views": number, "scenes": len(own), "refused": len(all_own) - len(own)}
        for name in ("psnr", "ssim", "depth", "gaussians", "seconds", "memory"):
            values = [row[name] for row in own if name in row]
            if values:
                line[name] = float(np.mean(values))
        line["grown"] = float(np.mean([r["gaussians"] / two[r["of"]]["gaussians"] for r in own]))
        if number > 2:
            over = np.array([row["psnr"] - two[row["of"]]["psnr"] for row in own])
            best = np.array([row["psnr"] - row["best_two_psnr"] for row in own])
            line |= {"gain": over.mean(), "worst": over.min()}
            line |= {"spread": over.std(ddof=1)} if len(own) > 1 else {}
            line |= {"over_best": best.mean(), "worst_over_best": best.min()}
        found.append(line)
    return found


COLUMNS = {
    "views": ("views", "d"),
    "scenes": ("scenes", "d"),
    "psnr": ("PSNR", ".2f"),
    "gain": ("over two", "+.2f"),
    "spread": ("spread", ".2f"),
    "worst": ("worst", "+.2f"),
    "over_best": ("over best two", "+.2f"),
    "worst_over_best": ("worst", "+.2f"),
    "ssim": ("SSIM", ".3f"),
    "depth": ("depth error", ".3f"),
    "gaussians": ("Gaussians", ",.0f"),
    "grown": ("times", ".2f"),
    "seconds": ("CPU, s", ".1f"),
    "memory": ("peak, MB", ",.0f"),
    "refused": ("refused", "d"),
}


def summary_table(rows: Sequence[Row], numbers: Sequence[int]) -> str:
    """The summary as Markdown; a column that no number has is left out."""
    lines = summary(rows, numbers)
    return table(lines, {k: v for k, v in COLUMNS.items() if any(k in line for line in lines)})


def reasons(rows: Sequence[Row]) -> list[str]:
    """Why numbers of views were refused, and of what; the advice is left out."""
    return [
        f"{row['views']} views, {row['of']}: {row['refused'].split(';')[0]}"
        for row in rows
        if "refused" in row
    ]


def whole_numbers(text: str) -> tuple[int, ...]:
    """The argument of ``--views``."""
    return tuple(sorted({2, *map(int, text.split(","))}))


def _of_pair(scene: Scene, pair: Sequence[str], targets: Sequence[str]) -> Row:
    try:
        sample = scene.sample(pair, targets, SIZE)
        return at_targets(sample, PlaneSweep()(sample))
    except SLGaussianError:
        return {}


def _psnr(row: Row) -> float:
    return row.get("psnr", -np.inf)
