"""What context views are worth that lead outward along a walk, away from the target.

    python -m benches.views.outward WALK [--views 2,3,4,6] [--every 10]

WALK is a nerfstudio folder of a walk, its frames in the order of their names. In a window every
second frame is a context view, and the target is the frame between the first two, whatever the
number of views: further ones lead away from it. A window begins at every tenth frame. Figures are
those of ``benches/views/built_fields.py``, over the windows that two views can do.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

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
from slgaussian.kernels import threads

NUMBERS = (2, 3, 4, 6)
EVERY = 10


def starts(frames: int, numbers: Sequence[int], every: int) -> range:
    """Where windows begin in a walk of so many frames."""
    return range(0, frames - 2 * max(numbers) + 2, every)


def windows(folder: Path, numbers: Sequence[int], every: int) -> range:
    """The starts of the windows of a walk."""
    return starts(len(datasets.load("nerfstudio", folder).cameras), numbers, every)


def window(folder: Path, numbers: Sequence[int], start: int) -> Iterator[Row]:
    """The rows of the window that begins at a frame."""
    scene = datasets.load("nerfstudio", folder)
    names = sorted(scene.cameras)[start : start + 2 * max(numbers) - 1]
    contexts = {number: names[: 2 * number - 1 : 2] for number in numbers}
    yield from by_numbers(scene, contexts, names[1:2], f"frame {start}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("walk", type=data_folder("transforms.json"))
    parser.add_argument("--views", type=whole_numbers, default=NUMBERS)
    parser.add_argument("--every", type=int, default=EVERY)
    given = parser.parse_args()
    threads.limit()
    warm_up()
    rows: list[Row] = []
    for start in windows(given.walk, given.views, given.every):
        rows += window(given.walk, given.views, start)
        print(f"window at frame {start} done", flush=True)
    print(summary_table(rows, given.views))
    print("\n".join(reasons(rows)))


if __name__ == "__main__":
    main()
