"""What well-kept libraries have of what kernels of ours do: the same answers, and how fast.

python -m benches.common.own_kernels

The nearest code in L1 against ``scipy.spatial.cKDTree``, and the weighted median of depth against
``cv2.ximgproc.weightedMedianFilter``, on random numbers of the size of a photograph of 416 x 576.
Milliseconds of the processor are medians of five rounds.
"""

import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial import cKDTree

from benches.common.machine import machine
from slgaussian.language.nearest import nearest_code
from slgaussian.predict.depth_completion import MEDIAN_COLOR, MEDIAN_RADIUS, weighted_median

SIZE = (416, 576)
LOW, RANGE, CANDIDATES = 0.1, 0.5, 144


def measured(work: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    spent = []
    for _ in range(5):
        start = time.process_time()
        made = work()
        spent.append(time.process_time() - start)
    return 1000 * float(np.median(spent)), made


def main() -> None:
    print(machine())
    rng = np.random.default_rng(0)
    codes, values = rng.random((60, 3)), rng.random((SIZE[0] * SIZE[1], 3))
    nearest_code(values, codes)
    tree = cKDTree(codes)
    ours, mine = measured(lambda: nearest_code(values, codes))
    theirs, other = measured(lambda: tree.query(values, p=1)[1])
    print(
        f"nearest code: {ours:.0f} ms, cKDTree {theirs:.0f} ms, {np.mean(mine != other):.1%} differ"
    )
    coarse, grid = np.round(8 * values) / 8, np.round(4 * codes) / 4
    tied = np.mean(nearest_code(coarse, grid) != cKDTree(grid).query(coarse, p=1)[1])
    print(f"on a grid, where distances tie, {tied:.0%} differ")

    image = cv2.GaussianBlur(rng.integers(0, 255, (*SIZE, 3)).astype(np.uint8), (0, 0), 3)
    depth = cv2.GaussianBlur(rng.random(SIZE).astype(np.float32), (0, 0), 5)
    depth = LOW + RANGE * (depth - depth.min()) / np.ptp(depth)
    step = RANGE / CANDIDATES
    weighted_median(depth, image, LOW, step)
    ours, mine = measured(lambda: weighted_median(depth, image, LOW, step))
    library = cv2.ximgproc.weightedMedianFilter
    theirs, other = measured(
        lambda: library(image, depth, MEDIAN_RADIUS, MEDIAN_COLOR, cv2.ximgproc.WMF_EXP)
    )
    rms = np.sqrt(np.mean((mine - other) ** 2)) / step
    print(f"weighted median: {ours:.0f} ms, OpenCV {theirs:.0f} ms, {rms:.1f} candidates apart")


if __name__ == "__main__":
    main()
