"""What finding cameras costs, by part, pixels and number of views.

    python -m benches.cameras.finding_cost PHOTO PHOTO [PHOTO ...]

Photographs of one place, of 960 pixels or more. CPU seconds, the median of several runs, with
OpenCV and BLAS on as many threads as they like; the second program in the same run is plain
OpenCV's relative pose with the focal length guessed. Memory is the peak of the whole process.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benches.cameras import plain_opencv
from slgaussian.cameras.epipolar import solve
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.matches import find_features, match
from slgaussian.cameras.subpixel import sharpen
from slgaussian.cameras.two_view import (
    CONTRAST,
    FEATURES,
    RATIO,
    Described,
    Photograph,
    find_pair,
    focal_prior,
)
from slgaussian.datasets.unposed import photograph

SIZES = (480, 720, 960, 1200)
REPEATS = 3


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Median CPU and wall seconds."""
    both = []
    for _ in range(REPEATS):
        start = time.process_time(), time.perf_counter()
        work()
        both.append((time.process_time() - start[0], time.perf_counter() - start[1]))
    cpu, wall = np.median(both, axis=0)
    return float(cpu), float(wall)


def shrunk(taken: Photograph, longer: int) -> Photograph:
    height, width = taken.image.shape[:2]
    part = longer / max(height, width)
    size = round(width * part), round(height * part)
    how = cv2.INTER_AREA if part < 1 else cv2.INTER_CUBIC
    return replace(taken, image=cv2.resize(taken.image, size, interpolation=how))


def by_part(a: Photograph, b: Photograph) -> dict[str, float]:
    """CPU seconds of each part of a pair."""
    one, two = Described.of(a), Described.of(b)
    i, j, ratios = match(one.features, two.features, RATIO)
    order = np.argsort(ratios, kind="stable")
    i, j = i[order], j[order]
    greys = one.grey, two.grey
    x = one.features.points[i] - one.middle
    y = sharpen(greys, one.features, two.features, i, j) - two.middle

    def opencv() -> None:
        found = plain_opencv.matches(a.image, b.image)
        K = [plain_opencv.guessed(p.image.shape[1], p.image.shape[0]) for p in (a, b)]
        plain_opencv.relative_pose(*found, *K)

    parts: dict[str, Callable[[], object]] = {
        "features": lambda: [find_features(grey, FEATURES, CONTRAST) for grey in greys],
        "matches": lambda: match(one.features, two.features, RATIO),
        "sharpened": lambda: sharpen(greys, one.features, two.features, i, j),
        "solved": lambda: solve(x, y, focal_prior(one, two)),
        "pair in all": lambda: find_pair(Described.of(a), Described.of(b)),
        "plain OpenCV": opencv,
    }
    return {name: timed(work)[0] for name, work in parts.items()}


def main() -> None:
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    taken = [photograph(Path(file), Path(file).name) for file in sys.argv[1:]]
    names = ["longer side, pixels", *by_part(*[shrunk(p, 240) for p in taken[:2]])]
    print("| " + " | ".join(names) + " |\n" + "|---" * len(names) + "|")
    for size in SIZES:
        parts = by_part(*[shrunk(p, size) for p in taken[:2]])
        print(f"| {size} | " + " | ".join(f"{seconds:.2f}" for seconds in parts.values()) + " |")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\npeak of the process so far: {peak:.0f} MiB\n")
    print("| views at 960 pixels | CPU s | wall s |\n|---|---|---|")
    for count in range(2, len(taken) + 1):
        some = [shrunk(p, 960) for p in taken[:count]]
        cpu, wall = timed(lambda some=some: find_cameras(some))
        print(f"| {count} | {cpu:.2f} | {wall:.2f} |")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\npeak of the process: {peak:.0f} MiB")


if __name__ == "__main__":
    main()
