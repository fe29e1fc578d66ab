"""Pairs and chains of photographs whose cameras are known.

DATA is a folder with ``office`` and optionally ``places``, ``fern`` and ``office_walk``. Cameras of
``places`` and ``fern`` come from structure from motion, the others from device tracking; all are
used as ground truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benches.common.photograph_pairs import read_pairs
from slgaussian import datasets
from slgaussian.datasets.pair_selection import overlaps
from slgaussian.scene import Scene, View

WALK_PAIRS = 80
WALK_GAP = 4
LEAST_SHARED = 0.3
LEAST_BASELINE = 0.05
"""Smallest overlap of two views of a walk, at their median depth, and smallest baseline as a
fraction of that depth."""

FERN_PAIRS = 10

UNSURE_FOCAL = ("street",)
"""Places without reference focal length: forward motion on a road does not determine it."""


@dataclass(frozen=True, eq=False)
class PosedPair:
    """Two photographs with their cameras.

    Attributes:
        group: "office", "places", "fern" or "walk".
        name: Unique among all pairs.
        focal_known: Whether the focal length of the cameras is reliable.
    """

    group: str
    name: str
    a: View
    b: View
    focal_known: bool


def posed_pairs(data: Path) -> Iterator[PosedPair]:
    """Yield all pairs, group by group."""
    if (data / "office" / "pairs.json").is_file():
        scene = datasets.load("nerfstudio", data / "office")
        for name, (context, _) in read_pairs(data / "office" / "pairs.json").items():
            yield _pair("office", name, scene, *context)
    for folder in sorted((data / "places").glob("*")):
        if (folder / "pairs.json").is_file():
            yield from _of_place(folder)
    if (data / "fern").is_dir():
        scene = datasets.load("llff", data / "fern")
        names = list(scene.cameras)
        for i in range(FERN_PAIRS):
            partner = names[(2 * i + 1 + i % 3) % len(names)]
            yield _pair("fern", f"fern_{i}", scene, names[2 * i], partner)
    if (data / "office_walk").is_dir():
        yield from _pairs_of_walk(datasets.load("nerfstudio", data / "office_walk"))


def _of_place(folder: Path) -> Iterator[PosedPair]:
    """Yield the two context photographs of each scene, and each of them with the target."""
    scene = datasets.load("nerfstudio", folder)
    for name, ((a, b), (target, *_)) in read_pairs(folder / "pairs.json").items():
        for ending, first, second in (("", a, b), ("_a", a, target), ("_b", target, b)):
            has_focal = folder.name not in UNSURE_FOCAL
            yield _pair("places", name + ending, scene, first, second, has_focal)


def _walk(scene: Scene) -> tuple[list[View], Callable[[int, int], bool]]:
    """Return the views of a walk, and a test of two views for sufficient baseline and overlap."""
    views = [scene.read(name) for name in scene.cameras]
    depths = [float(np.median(view.depth[view.depth > 0])) for view in views]

    def usable(first: int, second: int) -> bool:
        a, b = views[first].camera, views[second].camera
        shares = overlaps([a, b], np.array([depths[first], depths[second]]))
        baseline = np.linalg.norm(a.center - b.center)
        enough = LEAST_BASELINE * (depths[first] + depths[second]) / 2
        return min(shares[0, 1], shares[1, 0]) >= LEAST_SHARED and bool(baseline >= enough)

    return views, usable


def _pairs_of_walk(scene: Scene) -> Iterator[PosedPair]:
    """Yield evenly spaced usable pairs of views that are at most four steps apart."""
    views, usable = _walk(scene)
    pairs = [
        (first, second)
        for first in range(len(views))
        for second in range(first + 1, min(first + WALK_GAP + 1, len(views)))
        if usable(first, second)
    ]
    for i in range(WALK_PAIRS):
        first, second = pairs[round(i * (len(pairs) - 1) / (WALK_PAIRS - 1))]
        yield PosedPair("walk", f"walk_{first}_{second}", views[first], views[second], True)


def _pair(
    group: str, name: str, scene: Scene, a: str, b: str, focal_known: bool = True
) -> PosedPair:
    return PosedPair(group, name, scene.read(scene.find(a)), scene.read(scene.find(b)), focal_known)


LENGTHS = (3, 4, 5, 6, 7, 8)

WALK_CHAINS = 12


@dataclass(frozen=True, eq=False)
class PosedChain:
    """Photographs of one place with their cameras, and whether their focal length is reliable."""

    group: str
    name: str
    views: Sequence[View]
    focal_known: bool = True


def posed_chains(data: Path) -> Iterator[PosedChain]:
    """Yield all chains, group by group."""
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
        yield from _chains_of_walk(datasets.load("nerfstudio", data / "office_walk"))


def _chains_of_walk(scene: Scene) -> Iterator[PosedChain]:
    """Yield evenly spaced chains of usable neighbours, of every or every second view."""
    views, usable = _walk(scene)
    for k in range(WALK_CHAINS):
        length, gap = LENGTHS[k % len(LENGTHS)], 1 + k % 2
        first = round(k * (len(views) - 1) / WALK_CHAINS)
        for start in range(first, len(views) - gap * (length - 1)):
            chain = range(start, start + gap * length, gap)
            if all(usable(i, i + gap) for i in chain[:-1]):
                yield PosedChain("walk", f"walk_{start}_{gap}_{length}", [views[i] for i in chain])
                break
