"""What context views are worth that fill one span more densely.

    python -m benches.views.spread DATA [--views 2,3,4,6,8] [--rooms 20]

DATA holds ``fern`` (a forward-facing capture of LLFF) and ``places`` (pairs of photographs with a
target between them). Every number is asked at the same targets:

- fern: three photographs, a quarter, half and three quarters along its widest direction. Context
  views are spread evenly over the others, without the two at either end of that direction.
- places: those that have more than three photographs, from the pairs of ``pairs.json`` on, by the
  rule of ``slgaussian/datasets/context_views.py``, as many as there are.
- rooms: made-up ones with exact depth, on an arc 1.6 m long, 3.3 m from the middle; three targets
  in gaps that all numbers leave. Context views are spread evenly over the arc.

Figures are those of ``benches/views/built_fields.py``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benches.common.photograph_pairs import data_folder
from benches.views.built_fields import (
    Row,
    by_numbers,
    reasons,
    summary_table,
    warm_up,
    whole_numbers,
)
from slgaussian import datasets
from slgaussian.benchmark.index import read_index
from slgaussian.datasets.context_views import context_of
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.scene import Scene

NUMBERS = (2, 3, 4, 6, 8)
ROOMS = 20

ARC = 210
"""Steps of the arc of a room: 1, 2, 3, 5 and 7 divide them, so 2, 3, 4, 6 and 8 views are even."""
TARGETS = (51, 112, 159)
"""Steps that are at least 7 from the context views of each of these numbers."""
BASELINE, SIZE = 1.6, {"height": 208, "width": 288}


def fern(folder: Path, numbers: Sequence[int]) -> Iterator[Row]:
    """The rows of a forward-facing capture."""
    scene = datasets.load("llff", folder)
    names = _along(scene)
    held = [names[len(names) * k // 4] for k in (1, 2, 3)]
    rest = [name for name in names[2:-2] if name not in held]
    contexts = {number: _evenly(rest, number) for number in numbers}
    yield from by_numbers(scene, contexts, held, folder.name)


def place(folder: Path, numbers: Sequence[int]) -> Iterator[Row]:
    """The rows of each pair of a place, with as many views as it has photographs for."""
    scene = datasets.load("nerfstudio", folder)
    for pair in read_index(folder / "pairs.json").pairs:
        contexts = {}
        for number in numbers:
            try:
                contexts[number] = context_of(scene, pair.context, pair.targets, number)
            except InputError:  # too few photographs
                break
        yield from by_numbers(scene, contexts, pair.targets, pair.scene)


def places(folder: Path) -> list[str]:
    """The names of the places that have more photographs than a pair and its target."""
    held = sorted(child for child in folder.iterdir() if (child / "pairs.json").is_file())
    return [one.name for one in held if len(datasets.load("nerfstudio", one).cameras) > 3]


def room(seed: int, numbers: Sequence[int]) -> Iterator[Row]:
    """The rows of a made-up room."""
    scene = datasets.load("procedural", seed, views=ARC + 1, baseline=BASELINE, **SIZE)
    names = list(scene.cameras)
    contexts = {number: _evenly(names, number) for number in numbers}
    yield from by_numbers(scene, contexts, [names[k] for k in TARGETS], f"room {seed}")


def _along(scene: Scene) -> list[str]:
    """The views by their place along the widest direction."""
    names = list(scene.cameras)
    centers = np.array([scene.cameras[name].center for name in names])
    offsets = centers - centers.mean(0)
    return [names[i] for i in np.argsort(offsets @ np.linalg.svd(offsets)[2][0])]


def _evenly(names: Sequence[str], count: int) -> list[str]:
    return [names[round(i * (len(names) - 1) / (count - 1))] for i in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=data_folder("fern/poses_bounds.npy", "places"))
    parser.add_argument("--views", type=whole_numbers, default=NUMBERS)
    parser.add_argument("--rooms", type=int, default=ROOMS)
    given = parser.parse_args()
    threads.limit()
    warm_up()
    numbers, held = given.views, given.data / "places"
    sets = {
        "fern": list(fern(given.data / "fern", numbers)),
        "places": [row for name in places(held) for row in place(held / name, numbers)],
        "rooms": [row for seed in range(given.rooms) for row in room(seed, numbers)],
    }
    for name, rows in sets.items():
        print(f"\n{name}\n\n{summary_table(rows, numbers)}")
        print("\n".join(reasons(rows)))


if __name__ == "__main__":
    main()
