"""Binning of splats into tiles of the image, and sorting by depth.

A tile consists of blocks of pixels, each a SIMD vector. Its splats are gathered into a small
workspace, sorted by depth, and listed for each block: drawing a block iterates over one list with
its pixels in registers.

Nothing here depends on the number of threads: lists are filled in parts of fixed size, in the order
of the input, and the sort is stable.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, lowest_bit, prefetch
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.project import CUT, MAX_COORDINATE, POWER, ROOT, ROW_ROOT, SLOPE, U, V, Z

BLOCK = 4
"""Side of a block in pixels; a block is one vector. Square blocks waste fewest lanes."""

assert BLOCK * BLOCK == LANES

LANE_COLUMNS, LANE_ROWS = (np.float32(lane.ravel()) for lane in np.indices((BLOCK, BLOCK))[::-1])
"""Column and row of each lane in its block."""

TILE_WIDTH, TILE_HEIGHT = 16, 32
"""Size of a tile in pixels. Larger tiles sort fewer splats repeatedly, but have larger workspaces.
Measured: 8x32 is slower by a tenth, 16x16 by a twentieth, 16x64 no faster."""

BLOCKS_ACROSS = TILE_WIDTH // BLOCK
TILE_BLOCKS = BLOCKS_ACROSS * TILE_HEIGHT // BLOCK

assert TILE_BLOCKS == 32  # a bit of a uint32 each

ROW_STARTS = np.uint64(sum(1 << BLOCKS_ACROSS * row for row in range(TILE_BLOCKS // BLOCKS_ACROSS)))
"""Bit mask of the first block of each row of blocks."""

PARTS = 16
"""Number of parts in which splats are counted and binned in parallel."""

STRIP_TILES = 8
"""Consecutive tiles of a work item, which share splats."""

RADIX_BITS = 11
"""Bits of depth in one pass of the radix sort: most tiles need two passes, with eight bits three.
"""

PREFETCH_DISTANCE = 12
"""Prefetch distance in splats."""

LOCAL_SPLAT = np.dtype(
    [(name, np.float32) for name in ("x", "y", "root", "slant", "row_root", "power", "cut", "_")]
)
"""A splat in its tile. Its centre is in pixels from the first of the tile's middle row: x where it
crosses that row, so that a long splat's far centre costs no digits. The slant is root times slope.
"""


class Bins(NamedTuple):
    """Splats by tile: tile t, in row-major order, is ``entries[starts[t] : starts[t + 1]]``."""

    across: int
    down: int
    starts: np.ndarray
    entries: np.ndarray


class Workspace(NamedTuple):
    """Workspace for the n splats of one tile.

    Attributes:
        keys, more_keys: uint64 [n]. To sort, and to sort into: z in the upper half, the splat in
            the lower.
        local: :data:`LOCAL_SPLAT` [n]. The splat in the tile's own pixels.
        reach: uint32 [n]. A bit for each block of the tile that the splat may touch.
        carried: float32 [n (C + 1) + LANES]. The values and z of each splat.
        lists: int32 [TILE_BLOCKS n]. Block b lists its splats, front to back, in ``lists[b n : b n
            + counts[b]]``.
        counts: int64 [TILE_BLOCKS]
        weights: float32 [n LANES]. For the use of who draws a block.
    """

    keys: np.ndarray
    more_keys: np.ndarray
    local: np.ndarray
    reach: np.ndarray
    carried: np.ndarray
    lists: np.ndarray
    counts: np.ndarray
    weights: np.ndarray


@kernel(inline="always")
def make_workspace(bins, channels):
    """Make a :class:`Workspace` for the splats of the fullest tile, of ``channels`` values."""
    n = 1
    for tile in range(bins.across * bins.down):
        n = max(n, bins.starts[tile + 1] - bins.starts[tile])
    return Workspace(
        np.empty(n, np.uint64),
        np.empty(n, np.uint64),
        np.empty(n, LOCAL_SPLAT),
        np.empty(n, np.uint32),
        np.zeros(n * (channels + 1) + LANES, np.float32),
        np.empty(TILE_BLOCKS * n, np.int32),
        np.empty(TILE_BLOCKS, np.int64),
        np.empty(n * LANES, np.float32),
    )


def bin_splats(boxes: np.ndarray, width: int, height: int) -> Bins:
    """Bin the splats with pixel ``boxes`` int32 [N, 4] by tile; returns :class:`Bins`."""
    across, down = -(-width // TILE_WIDTH), -(-height // TILE_HEIGHT)
    cursors = np.zeros((PARTS, across * down), np.int64)
    share(_bin, PARTS, boxes, across, cursors, np.empty(0, np.int32), False)
    # Counted first, then written where the counts say: each part has a place of its own in each
    # tile, so that parts need no locks and leave the order of the input. Tile by tile, and part by
    # part in each.
    ends = np.cumsum(cursors.T).reshape(-1, PARTS)
    cursors[:] = ends.T - cursors
    starts = np.append(cursors[0], ends[-1, -1])
    entries = np.empty(starts[-1], np.int32)
    share(_bin, PARTS, boxes, across, cursors, entries, True)
    return Bins(across, down, starts, entries)


@kernel
def _bin(counter, boxes, across, cursors, entries, write):
    """Count the splats of each tile and part, or ``write`` them at the cursors."""
    n, part = len(boxes), take(counter)
    while part < PARTS:
        for i in range(part * n // PARTS, (part + 1) * n // PARTS):
            left, right, top, bottom = tile_range(boxes[i])
            for y in range(top, bottom):
                for x in range(left, right):
                    tile = y * across + x
                    if write:
                        entries[cursors[part, tile]] = i
                    cursors[part, tile] += 1
        part = take(counter)


def count_strips(bins: Bins) -> int:
    """Return the number of work items of :data:`STRIP_TILES` tiles."""
    return -(-bins.across * bins.down // STRIP_TILES)


@kernel(inline="always")
def tile_range(box):
    """Return the half-open ranges of tiles, across and down, that a pixel box touches."""
    if box[1] <= box[0] or box[3] <= box[2]:
        return 0, 0, 0, 0
    # Unsigned, so that the divisions are shifts; boxes are within the image, so never negative.
    wide, tall = np.uint32(TILE_WIDTH), np.uint32(TILE_HEIGHT)
    return (
        np.int64(np.uint32(box[0]) // wide),
        np.int64(np.uint32(box[1] - 1) // wide) + 1,
        np.int64(np.uint32(box[2]) // tall),
        np.int64(np.uint32(box[3] - 1) // tall) + 1,
    )


@kernel
def count_tiles(boxes):
    """Return the exclusive cumulative number of tiles that splats touch, int64 [N + 1]."""
    # Gradients of a splat have a row for each of its tiles: the sums give each row its place, and
    # tiles write theirs without waiting for each other.
    firsts = np.zeros(len(boxes) + 1, np.int64)
    for i in range(len(boxes)):
        left, right, top, bottom = tile_range(boxes[i])
        firsts[i + 1] = firsts[i] + (right - left) * (bottom - top)
    return firsts


@kernel(inline="always")
def load_tile(tile, bins, splats, boxes, values, work):
    """Fill the workspace with the splats of ``tile``; returns its left and top pixel.

    Splat k of the workspace is ``bins.entries[bins.starts[tile] + k]``.
    """
    # Three passes: gather the splats of the tile from all over memory into one contiguous
    # workspace, in its own pixels; sort their keys, not the splats; deal them to the lists of the
    # blocks, which are then sorted too. Blending only reads the workspace, once for each of its 32
    # blocks.
    left = (tile % bins.across) * TILE_WIDTH
    top = (tile // bins.across) * TILE_HEIGHT
    start = bins.starts[tile]
    n = bins.starts[tile + 1] - start
    channels = values.shape[1]
    nearest, farthest = np.float32(np.inf), np.float32(0)
    # Numba counts references to what it takes out of a tuple, each time.
    entries, local, reach, carried = bins.entries, work.local, work.reach, work.carried
    last = len(entries) - 1
    for k in range(n):
        # Entries of a tile are scattered: ask for those that are needed a few turns later.
        ahead = entries[min(start + k + PREFETCH_DISTANCE, last)]
        prefetch(splats, ahead * splats.shape[1])
        prefetch(boxes, ahead * 4)
        prefetch(values, ahead * channels)
        i = np.uint32(entries[start + k])
        # In float64, before the rounding to float32: within a tile, coordinates are small, and
        # their digits go to fractions of a pixel.
        y = splats[i, V] - (top + TILE_HEIGHT // 2) - 0.5
        x = splats[i, U] - left - 0.5 - splats[i, SLOPE] * y
        local[k].x = min(max(x, -MAX_COORDINATE), MAX_COORDINATE)
        local[k].y = y
        local[k].root = splats[i, ROOT]
        local[k].slant = splats[i, ROOT] * splats[i, SLOPE]
        local[k].row_root = splats[i, ROW_ROOT]
        local[k].power = splats[i, POWER]
        local[k].cut = splats[i, CUT]
        # The blocks that the box touches, as bits: a run of columns, repeated in a run of rows. The
        # product copies the run of columns to the start of each row, without carry.
        x0, x1 = max(0, boxes[i, 0] - left) // BLOCK, min(TILE_WIDTH, boxes[i, 1] - left) - 1
        y0, y1 = max(0, boxes[i, 2] - top) // BLOCK, min(TILE_HEIGHT, boxes[i, 3] - top) - 1
        across = (2 << np.uint32(x1 // BLOCK)) - (1 << np.uint32(x0))
        down = (np.uint64(2) << np.uint64(y1 // BLOCK * BLOCKS_ACROSS + BLOCKS_ACROSS - 1)) - (
            np.uint64(1) << np.uint64(y0 * BLOCKS_ACROSS)
        )
        reach[k] = np.uint64(across) * (down & ROW_STARTS)
        at = k * (channels + 1)
        for c in range(channels):
            carried[at + c] = values[i, c]
        z = np.float32(splats[i, Z])
        carried[at + channels] = z
        nearest, farthest = min(nearest, z), max(farthest, z)
    order = _sort_by_depth(n, channels, nearest, farthest, work)
    lists, counts = work.lists, work.counts
    capacity = np.uint64(len(work.keys))
    counts[:] = 0
    for j in range(n):
        entry = np.uint32(order[j])  # the lower half
        # Blocks of a splat are found by its set bits, not by testing all 32.
        left_over = reach[entry]
        while left_over:
            block = lowest_bit(left_over)
            count = counts[block]
            lists[np.uint64(block) * capacity + np.uint64(count)] = entry
            counts[block] = count + 1
            left_over &= left_over - np.uint32(1)
    return left, top


@kernel(inline="always")
def find_corner(block, left, top):
    """Return the first pixel of a block of the tile whose first pixel is ``left, top``."""
    return left + block % BLOCKS_ACROSS * BLOCK, top + block // BLOCKS_ACROSS * BLOCK


@kernel
def _sort_by_depth(n, channels, nearest, farthest, work):
    """Return the keys of the splats of the workspace by rising depth, in a stable order.

    Radix sort over the bits of the float32 z: positive floats are in the order of their bits, and
    close ones share the upper bits, which then need no pass.
    """
    # Only the bits in which the depths of this tile can differ are sorted, in as few passes as fit
    # the digits; the histograms of all passes are counted while the keys are written. Sorting is
    # stable, so that equal depths keep the order of the input, as the model says.
    z = work.carried.view(np.uint32)
    limits = np.array([nearest, farthest], np.float32).view(np.uint32)
    bits = 0
    while (limits[1] - limits[0]) >> np.uint64(bits):
        bits += 1
    passes = -(-bits // RADIX_BITS)
    width = np.uint64(-(-bits // max(passes, 1)))
    mask = (np.uint64(1) << width) - np.uint64(1)
    starts = np.zeros((passes, mask + 1), np.int32)
    # z in the upper half of a key, and the number of the splat in the lower, so that one move sorts
    # both.
    for k in range(n):
        key = np.uint64(z[k * (channels + 1) + channels] - limits[0])
        work.keys[k] = key << np.uint64(32) | np.uint64(k)
        for digit in range(passes):
            starts[digit, key & mask] += 1
            key >>= width
    keys, more_keys = work.keys, work.more_keys
    for digit in range(passes):
        total = 0
        for value in range(mask + 1):
            total, starts[digit, value] = total + starts[digit, value], total
        shift = np.uint64(32) + np.uint64(digit) * width
        for k in range(n):
            value = (keys[k] >> shift) & mask
            more_keys[starts[digit, value]] = keys[k]
            starts[digit, value] += 1
        keys, more_keys = more_keys, keys
    return keys
