"""Sums of the blending weights of each Gaussian over the pixels of each label of an image.

The weights are those of compositing (:func:`slgaussian.rasterize.blend.blend_weights`). A tile has
few labels: its sums are a table of its splats by its own labels, written by one thread, so that no
matrix of pixels by Gaussians exists, and the sums do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from slgaussian.gaussians import Gaussians
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vload, vsum
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.blend import SplatScene, blend_weights
from slgaussian.rasterize.picture import GEOMETRY, draw_splats
from slgaussian.rasterize.project import make_eye
from slgaussian.rasterize.render_settings import find_settings
from slgaussian.rasterize.tiles import (
    BLOCK,
    STRIP_TILES,
    TILE_BLOCKS,
    TILE_HEIGHT,
    TILE_WIDTH,
    count_strips,
    find_corner,
    load_tile,
    make_workspace,
)
from slgaussian.scene import Camera


def sum_label_weights(
    gaussians: Gaussians,
    labels: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    count: int,
    settings: str = "3dgs",
) -> sparse.csr_array:
    """Sum the blending weights of each Gaussian over the pixels of each label, over all views.

    Args:
        labels: V of int32 [H, W], from 0 to ``count`` - 1. The labels of the pixels of a view.
        cameras: V Camera, of the sizes of the label maps.
        settings: Preset of image formation, see :func:`slgaussian.rasterize.rasterize`.

    Returns:
        float64 [N, count], sparse: In pixels. A Gaussian that no view shows has no entry.
    """
    total = sparse.csr_array((len(gaussians), count))
    arrays = gaussians.to_arrays()
    geometry = [np.ascontiguousarray(arrays[name], np.float32) for name in GEOMETRY]
    nothing = np.zeros((len(gaussians), 1), np.float32)
    for view_labels, camera in zip(labels, cameras, strict=True):
        chosen = find_settings(settings, gaussians.reach(camera))
        eye = make_eye(gaussians.localize(camera), chosen)
        _, scene = draw_splats(gaussians, geometry, nothing, eye, chosen, False)
        total = total + _sum_view(scene, np.ascontiguousarray(view_labels, np.int32), total.shape)
    return total


def _sum_view(scene: SplatScene, labels: np.ndarray, shape: tuple[int, int]) -> sparse.csr_array:
    bins = scene.bins
    listed, ends, local = _list_labels(labels, bins.across, bins.down)
    counts = np.diff(ends, prepend=0)
    splats = np.diff(bins.starts)
    sums = np.zeros(int((counts * splats).sum()), np.float32)
    places = np.cumsum(counts * splats) - counts * splats
    share(_sum_weights, count_strips(bins), *scene, local, counts, places, sums)
    # The table of a tile has a row for each of its splats.
    widths = np.repeat(counts, splats)
    rows = np.repeat(bins.entries, widths)
    firsts = np.repeat(ends - counts, splats)
    columns = np.arange(len(sums)) - np.repeat(np.cumsum(widths) - widths - firsts, widths)
    seen = sums > 0
    entries = sums[seen].astype(np.float64), (rows[seen], listed[columns[seen]])
    return sparse.csr_array(sparse.coo_array(entries, shape=shape))


@kernel
def _list_labels(labels, across, down):
    """List the labels of each tile in the order in which they occur.

    Returns:
        int32 [M], int64 [T]: The labels of all tiles, and the end of each tile's.
        int32 [H, W]: The place of each pixel's label in the list of its tile.
    """
    height, width = labels.shape
    listed = np.empty(height * width, np.int32)
    ends = np.empty(across * down, np.int64)
    local = np.empty((height, width), np.int32)
    end = 0
    for tile in range(across * down):
        first = end
        left, top = tile % across * TILE_WIDTH, tile // across * TILE_HEIGHT
        for y in range(top, min(top + TILE_HEIGHT, height)):
            for x in range(left, min(left + TILE_WIDTH, width)):
                at = first
                while at < end and listed[at] != labels[y, x]:
                    at += 1
                if at == end:
                    listed[end] = labels[y, x]
                    end += 1
                local[y, x] = at - first
        ends[tile] = end
    return listed[:end].copy(), ends, local


@kernel
def _sum_weights(
    counter, splats, boxes, values, bins, alpha_max, pass_min, local, counts, places, sums
):
    height, width = local.shape
    strip, tiles = take(counter), bins.across * bins.down
    work = make_workspace(bins, values.shape[1])
    while strip * STRIP_TILES < tiles:
        for tile in range(strip * STRIP_TILES, min(tiles, (strip + 1) * STRIP_TILES)):
            left, top = load_tile(tile, bins, splats, boxes, values, work)
            place, columns = places[tile], counts[tile]
            for block in range(TILE_BLOCKS):
                x0, y0 = find_corner(block, left, top)
                if x0 >= width or y0 >= height:
                    continue
                used, _, _ = blend_weights(block, work, alpha_max, pass_min)
                first, label = block * len(work.keys), local[y0, x0]
                whole = y0 + BLOCK <= height and x0 + BLOCK <= width
                for y in range(y0, min(y0 + BLOCK, height)):
                    for x in range(x0, min(x0 + BLOCK, width)):
                        whole &= local[y, x] == label
                for j in range(used):
                    row = place + np.int64(work.lists[first + j]) * columns
                    if whole:
                        sums[row + label] += vsum(vload(work.weights, j * LANES))
                        continue
                    for y in range(y0, min(y0 + BLOCK, height)):
                        for x in range(x0, min(x0 + BLOCK, width)):
                            lane = (y - y0) * BLOCK + x - x0
                            sums[row + local[y, x]] += work.weights[j * LANES + lane]
        strip = take(counter)
