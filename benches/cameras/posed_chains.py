"""Chains of three to eight photographs whose cameras are known.

DATA is what :mod:`benches.cameras.posed_pairs` reads, without ``office``, whose scenes are pairs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benches.cameras.posed_pairs import LEAST_BASELINE, LEAST_SHARED, UNSURE_FOCAL
from slgaussian import datasets
from slgaussian.scene import Scene, View, shared_view

LENGTHS = (3, 4, 5, 6, 7, 8)

WALK_CHAINS = 12


@dataclass(frozen=True, eq=False)
class PosedChain:
    """Photographs of one place with their cameras, and whether its focal length is known."""

    group: str
    name: str
    views: Sequence[View]
    focal_known: bool = True


def posed_chains(data: Path) -> Iterator[PosedChain]:
    """All chains, group by group."""
    for folder in sorted((data / "places").glob("*")):
        if (folder / "transforms.json").is_file():
            scene = datasets.load("nerfstudio", folder)
            names = list(scene.cameras)
            for start in range(0, len(names) - 2, 3):
                views = [scene.read(name) for name in names[start : start + 3]]
                name = f"{folder.name}_{start // 3}"
                yield PosedChain("places", name, views, folder.name not in UNSURE_FOCAL)
    if (data / "fern").is_dir():
        scene = datasets.load("llff", data / "fern")
        names = list(scene.cameras)
        for length in LENGTHS:
            drawn = np.random.default_rng(length).choice(len(names), length, replace=False)
            views = [scene.read(names[i]) for i in sorted(drawn)]
            yield PosedChain("fern", f"fern_{length}", views)
    if (data / "office_walk").is_dir():
        yield from _of_walk(datasets.load("nerfstudio", data / "office_walk"))


def _of_walk(scene: Scene) -> Iterator[PosedChain]:
    """Evenly many chains of which each photograph shows what the one before it does.

    A chain takes every photograph or every second; as pairs have it, neighbours share enough of
    what they show, from far enough apart.
    """
    views = [scene.read(name) for name in scene.cameras]
    depths = [float(np.median(view.depth[view.depth > 0])) for view in views]

    def usable(i: int, j: int) -> bool:
        a, b = views[i].camera, views[j].camera
        shared = min(shared_view(a, b, depths[i]), shared_view(b, a, depths[j]))
        far = np.linalg.norm(a.center - b.center) / (depths[i] + depths[j]) * 2
        return shared >= LEAST_SHARED and bool(far >= LEAST_BASELINE)

    for k in range(WALK_CHAINS):
        length, gap = LENGTHS[k % len(LENGTHS)], 1 + k % 2
        first = round(k * (len(views) - 1) / WALK_CHAINS)
        for start in range(first, len(views) - gap * (length - 1)):
            chain = range(start, start + gap * length, gap)
            if all(usable(i, i + gap) for i in chain[:-1]):
                yield PosedChain("walk", f"walk_{start}_{gap}_{length}", [views[i] for i in chain])
                break
