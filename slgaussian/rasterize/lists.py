"""What every pixel of several views is composited from, in lists from which can be taken.

Lists are kept for blocks of 4x4 pixels, as the rasteriser draws them. They say what a change would
do to a picture exactly, at the price of compositing the blocks it touches and no others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from slgaussian.kernels.simd import LANES, vexp2, vload, vstore, vwhere, vzero
from slgaussian.kernels.work_sharing import WORKERS, take
from slgaussian.rasterize.blend import STRIP, weigh_block
from slgaussian.rasterize.project import POWER, ROOT, ROW_ROOT, SLOPE, Eye, U, V, Z, project
from slgaussian.rasterize.tiles import (
    ACROSS,
    BLOCK,
    DOWN,
    TILE_BLOCKS,
    bin_splats,
    corner_of,
    fullest,
    load_tile,
    make_workspace,
)

SPARE = 4
"""How many more entries a block has room for than it starts with."""

NOBODY = -1


class Lists(NamedTuple):
    """The lists of all blocks of all views, and where each Gaussian is in them.

    Attributes
    ----------
    starts, counts, rooms : int64 [blocks]
        Block b has the entries ``starts[b] : starts[b] + counts[b]``, front to back, and room for
        ``rooms[b]``.
    members : int32 [room of all]
        The Gaussian of each entry.
    alphas : float32 [room of all * LANES]
        Zero outside the image.
    views, left, top : int32 [blocks]
        The view each block belongs to, and its first pixel there.
    sizes : int64 [V, 4]
        Width, height, blocks across, and first block of each view.
    z : float32 [V, N]
    begins, ends : int64 [N]
        Gaussian i is in the blocks ``places[begins[i] : ends[i]]``.
    places : int32 [pool]
    used : int64 [1]
        How much of the pool is taken; who moves to other blocks gets a new part of it.
    """

    starts: np.ndarray
    counts: np.ndarray
    rooms: np.ndarray
    members: np.ndarray
    alphas: np.ndarray
    views: np.ndarray
    left: np.ndarray
    top: np.ndarray
    sizes: np.ndarray
    z: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    places: np.ndarray
    used: np.ndarray


def list_views(geometry: Sequence[np.ndarray], eyes: Sequence[Eye], alpha_max: float) -> Lists:
    """The lists of Gaussians in all views.

    Parameters
    ----------
    geometry : float32 [N, 3], [N, 3], [N, 4], [N]
        Means, scales, quaternions and opacities.
    eyes : sequence of Eye
    alpha_max : float
    """
    n = len(geometry[0])
    seen, own_counts, first = [], [], 0
    view, left, top, sizes, z = [], [], [], [], []
    for number, eye in enumerate(eyes):
        splats, boxes, _ = project(*geometry, np.empty((n, 0), np.float32), eye)
        scene = splats, boxes, bin_splats(boxes, eye.width, eye.height)
        across, down = -(-eye.width // BLOCK), -(-eye.height // BLOCK)
        count = np.zeros(across * down, np.int64)
        _walk(*scene, eye.width, eye.height, np.float32(alpha_max), count, False,
              np.empty(0, np.int32), np.empty(0, np.float32))  # fmt: skip
        y, x = np.indices((down, across)).reshape(2, -1) * BLOCK
        seen.append(scene)
        own_counts.append(count)
        view.append(np.full(across * down, number))
        left.append(x)
        top.append(y)
        sizes.append((eye.width, eye.height, across, first))
        z.append(splats[:, Z])
        first += across * down
    counts = np.concatenate(own_counts)
    rooms = counts + SPARE
    starts = np.cumsum(rooms) - rooms
    members = np.empty(rooms.sum(), np.int32)
    alphas = np.empty(rooms.sum() * LANES, np.float32)
    for (width, height, _, first), scene in zip(sizes, seen, strict=True):
        _walk(*scene, width, height, np.float32(alpha_max), starts[first:].copy(), True,
              members, alphas)  # fmt: skip
    begins, places = _turn(starts, counts, members, n)
    return Lists(
        starts, counts, rooms, members, alphas, _joined(view), _joined(left), _joined(top),
        np.array(sizes), np.array(z, np.float32), begins[:-1].copy(), begins[1:].copy(),
        # Room for everybody to move three times.
        np.concatenate([places, np.empty(3 * len(places) + 64, np.int32)]),
        np.array([len(places)]),
    )  # fmt: skip


def _joined(columns: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate(columns).astype(np.int32)


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _walk(splats, boxes, bins, width, height, alpha_max, cursors, write, members, alphas):
    """Move the cursor of every block on by its entries, and ``write`` them where it passes.

    A block has an entry for all that the rasteriser looks at there.
    """
    across = -(-width // BLOCK)
    nothing = np.empty((len(splats), 0), np.float32)
    most = fullest(bins)
    counter, tiles = np.zeros(1, np.int64), bins.across * bins.down
    for _worker in numba.prange(WORKERS):
        strip = take(counter)
        if strip * STRIP >= tiles:
            continue
        work = make_workspace(most, 0)
        while strip * STRIP < tiles:
            for tile in range(strip * STRIP, min(tiles, (strip + 1) * STRIP)):
                left, top = load_tile(tile, bins, splats, boxes, nothing, work)
                for block in range(TILE_BLOCKS):
                    x0, y0 = corner_of(block, left, top)
                    if x0 >= width or y0 >= height:
                        continue
                    place = y0 // BLOCK * across + x0 // BLOCK
                    count = work.counts[block]
                    if write:
                        entries = bins.entries[bins.starts[tile] :]
                        _write(block, count, work, alpha_max, width - x0, height - y0,
                               cursors[place], entries, members, alphas)  # fmt: skip
                    cursors[place] += count
            strip = take(counter)


# A function of its own: from inside a prange, Numba would leave out the call of weigh_block, whose
# result is not used.
@numba.njit(cache=True)
def _write(block, count, work, alpha_max, wide, tall, entry, splats, members, alphas):
    """Write the entries of a block, of which ``wide`` by ``tall`` pixels are in the image."""
    first = block * len(work.keys)
    listed = work.lists[first : first + count].copy()
    # Alone in its list, a splat has its alpha for a weight.
    work.counts[block] = 1
    for k in listed:
        work.lists[first] = k
        weigh_block(block, work, alpha_max, np.float32(0))
        members[entry] = splats[k]
        vstore(alphas, entry * LANES, inside(vload(work.weights, 0), wide, tall))
        entry += 1


@numba.njit(cache=True)
def _turn(starts, counts, members, n):
    begins = np.zeros(n + 1, np.int64)
    for block in range(len(starts)):
        for entry in range(starts[block], starts[block] + counts[block]):
            begins[members[entry] + 1] += 1
    begins = np.cumsum(begins)
    cursors = begins[:-1].copy()
    places = np.empty(begins[-1], np.int32)
    for block in range(len(starts)):
        for entry in range(starts[block], starts[block] + counts[block]):
            member = members[entry]
            places[cursors[member]] = block
            cursors[member] += 1
    return begins, places


@numba.njit(cache=True)
def inside(vector, wide, tall):
    """``vector`` in the first ``wide`` by ``tall`` pixels of a block, zero in the others."""
    vector = vwhere(vload(ACROSS, 0) < np.float32(wide), vector, vzero())
    return vwhere(vload(DOWN, 0) < np.float32(tall), vector, vzero())


@numba.njit(cache=True)
def falloff(block, splat, lists):
    """What the alpha of a splat is in a block, over its opacity: as the rasteriser has it."""
    width, height = lists.sizes[lists.views[block], :2]
    left, top = lists.left[block], lists.top[block]
    y = splat[V] - top - 0.5
    x = splat[U] - left - 0.5 - splat[SLOPE] * y
    root, row_root = splat[ROOT], splat[ROW_ROOT]
    e = vload(ACROSS, 0) * np.float32(root) - np.float32(root * x)
    e = e - vload(DOWN, 0) * np.float32(root * splat[SLOPE])
    d = vload(DOWN, 0) * np.float32(row_root) - np.float32(row_root * y)
    return inside(vexp2(np.float32(splat[POWER]) - e * e - d * d), width - left, height - top)


@numba.njit(cache=True)
def light_without(block, i, j, lists):
    """The light that passes all of a block's Gaussians but two."""
    light = vzero() + np.float32(1)
    for entry in range(lists.starts[block], lists.starts[block] + lists.counts[block]):
        if lists.members[entry] != i and lists.members[entry] != j:
            light = light - light * vload(lists.alphas, entry * LANES)
    return light


@numba.njit(cache=True)
def composite(block, i, j, alpha, z, lists, values, finished, drawn, weights, sums, at):
    """Composite a block without Gaussians i and j, with one in place of j.

    Parameters
    ----------
    alpha : vector
        Of the one in place of j; of none if zero.
    z : float32
        Its depth.
    values : float32 [N, C]
        Of the block's view.
    finished : float32
        The light below which a pixel takes no more.
    drawn, weights : int32 [room], float32 [room * LANES]
        To work in.
    sums : float32
        To it are written, from ``at``, the light that is left and the C sums of values, without
        those of the one in place of j, whose values need not be known.

    Returns
    -------
    vector
        The weight of the one in place of j.
    """
    channels = values.shape[1]
    light, weight = vzero() + np.float32(1), vzero()
    depths = lists.z[lists.views[block]]
    waits, count = True, 0
    for entry in range(lists.starts[block], lists.starts[block] + lists.counts[block]):
        member = lists.members[entry]
        if member in (i, j):
            continue
        if waits and (depths[member] > z or (depths[member] == z and member > j)):
            weight = vwhere(light >= finished, alpha * light, vzero())
            light = light - weight
            waits = False
        own = vwhere(light >= finished, vload(lists.alphas, entry * LANES) * light, vzero())
        light = light - own
        drawn[count] = member
        vstore(weights, count * LANES, own)
        count += 1
    if waits:
        weight = vwhere(light >= finished, alpha * light, vzero())
        light = light - weight
    vstore(sums, at, light)
    # Three at a time, as colours are; sums past the last channel are not stored.
    flat = values.reshape(values.size)
    for c in range(0, channels, 3):
        p, q, r = vzero(), vzero(), vzero()
        second, third = min(1, channels - 1 - c), min(2, channels - 1 - c)
        for k in range(count):
            own = vload(weights, k * LANES)
            value = np.int64(np.uint32(drawn[k])) * channels + c
            p = p + own * flat[value]
            q = q + own * flat[value + second]
            r = r + own * flat[value + third]
        to = at + (1 + c) * LANES
        vstore(sums, to, p)
        vstore(sums, to + second * LANES, q)
        vstore(sums, to + third * LANES, r)
    return weight


@numba.njit(cache=True)
def replace_in(block, i, j, alpha, has, z, lists):
    """Take i and j out of a block; where it ``has`` one in place of j, put that in."""
    start = lists.starts[block]
    end = start
    for entry in range(start, start + lists.counts[block]):
        if lists.members[entry] != i and lists.members[entry] != j:
            _move(entry, end, lists)
            end += 1
    if has:
        depths = lists.z[lists.views[block]]
        entry = end
        while entry > start:
            member = lists.members[entry - 1]
            if depths[member] < z or (depths[member] == z and member < j):
                break
            _move(entry - 1, entry, lists)
            entry -= 1
        lists.members[entry] = j
        vstore(lists.alphas, entry * LANES, alpha)
        end += 1
    lists.counts[block] = end - start


@numba.njit(cache=True)
def _move(entry, to, lists):
    lists.members[to] = lists.members[entry]
    vstore(lists.alphas, to * LANES, vload(lists.alphas, entry * LANES))
