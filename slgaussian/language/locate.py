"""The one pixel that stands for a region: the middle of where it is thickest."""

from __future__ import annotations

import math

import cv2
import numba
import numpy as np


def central_point(region: np.ndarray) -> tuple[int, int]:
    """The pixel (x, y) = (column, row) of a region that lies deepest inside it.

    In the largest 4-connected component of the bool [H, W] mask (the first in row-major order if
    several are largest), the pixel whose Euclidean distance to the nearest pixel outside is
    largest; the image ends at its edges. Ties go to the first pixel in row-major order.
    """
    x, y, w, h = cv2.boundingRect(region.view(np.uint8))
    row, column = _deepest(_largest_part(region[y : y + h, x : x + w]))
    return int(column) + x - 1, int(row) + y - 1


@numba.njit(cache=True)
def _largest_part(region: np.ndarray) -> np.ndarray:
    """The largest 4-connected part of bool [h, w], the first of equal ones, in a border of False.

    Runs of set pixels are joined with those that they touch in the row above; each points to an
    earlier run of its part, and the first stands for all.
    """
    h, w = region.shape
    most = h * ((w + 1) // 2)
    start, stop, row = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    parent = np.empty(most, np.int32)
    runs, above = 0, 0
    for i in range(h):
        first, touching = runs, above
        j = 0
        while j < w:
            if not region[i, j]:
                j += 1
                continue
            start[runs], row[runs], parent[runs] = j, i, runs
            while j < w and region[i, j]:
                j += 1
            stop[runs] = j
            while touching < first and stop[touching] <= start[runs]:
                touching += 1
            k = touching
            while k < first and start[k] < j:
                a, b = _root(parent, k), _root(parent, runs)
                parent[max(a, b)] = min(a, b)
                k += 1
            runs += 1
        above = first
    sizes = np.zeros(runs, np.int64)
    for k in range(runs):
        parent[k] = parent[parent[k]]
        sizes[parent[k]] += stop[k] - start[k]
    largest = sizes.argmax()
    part = np.zeros((h + 2, w + 2), np.bool_)
    for k in range(runs):
        if parent[k] == largest:
            part[row[k] + 1, start[k] + 1 : stop[k] + 1] = True
    return part


@numba.njit(cache=True)
def _root(parent: np.ndarray, run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@numba.njit(cache=True)
def _deepest(inside: np.ndarray) -> tuple[int, int]:
    """First pixel, in row-major order, with the greatest distance to the nearest one outside.

    What the exact distance transform would say, without most of it: distances are whole numbers
    once squared, and from a pixel to the next they grow by 1 at most, so a pixel known to be too
    near the outside rules out those beside it. ``inside`` [h, w] is False along its borders.
    """
    h, w = inside.shape
    upright = np.zeros((h, w), np.int32)  # distance to the nearest pixel outside in the column
    for i in range(1, h):
        for j in range(w):
            upright[i, j] = upright[i - 1, j] + 1 if inside[i, j] else 0
    for i in range(h - 2, -1, -1):
        for j in range(w):
            upright[i, j] = min(upright[i, j], upright[i + 1, j] + 1)
    # A first guess, halfway across the row that holds the highest column, is what others must beat.
    guess = np.int64(0)
    row, column = 0, 0
    for i in range(h):
        start = 0
        for j in range(1, w):
            if inside[i, j] and not inside[i, j - 1]:
                start = j
            if inside[i, j - 1] and not inside[i, j]:
                middle = (start + j - 1) // 2
                half = np.int64(min(upright[i, middle], middle - start + 1))
                if half > guess:
                    guess, row, column = half, i, middle
    best = _squared_distance(upright[row], column) - 1
    root = math.sqrt(best)
    for i in range(h):
        if not inside[i].any():
            continue
        j = 0
        while j < w:
            reach = float(upright[i, j])
            if reach > root:
                squared = _squared_distance(upright[i], j)
                reach = math.sqrt(squared)
                if squared > best:
                    best, root, row, column = squared, reach, i, j
            j += 1 + max(0, int(root - reach - 1e-6))
    return row, column


@numba.njit(cache=True)
def _squared_distance(upright: np.ndarray, column: int) -> np.int64:
    """To the nearest pixel outside, by its distances along every column of the pixel's row."""
    nearest = np.int64(upright[column]) ** 2
    step = np.int64(1)
    while step * step < nearest:
        for j in (column - step, column + step):
            if 0 <= j < len(upright):
                nearest = min(nearest, step * step + np.int64(upright[j]) ** 2)
        step += 1
    return nearest
